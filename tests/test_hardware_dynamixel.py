"""Recording and moving Dynamixel servos: ROBOTIS' own SDK against the emulator, with every fault it
can order.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest
from hypothesis import example, given, HealthCheck, settings, strategies as st

from emulators import Emulator, hand_over, PATIENT_S, signed, SLACK_S, writes
from jaxid.base.errors import UsageError
from jaxid.cli.app import main
from jaxid.data.io import load_dataset
from jaxid.hardware import Dynamixel, HardwareError, Limits, record, recover, Trajectory
from jaxid.hardware.dynamixel import registers as x
from jaxid.hardware.dynamixel.bus import Bus
from jaxid.hardware.link import Driver


pytestmark = pytest.mark.realtime

LIMITS = Limits(data_age=PATIENT_S)
RATE = 100.0


@pytest.fixture(scope="module")
def servo(tmp_path_factory):
    emulator = Emulator.servo(tmp_path_factory.mktemp("servo"))
    yield emulator
    emulator.close()


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    emulator = Emulator.servo(
        tmp_path_factory.mktemp("three"), "--id", "1", "--id", "2", "--id", "7"
    )
    yield emulator
    emulator.close()


def path(kind: str = "current", seconds: float = 2.0, amplitude: float = 0.3) -> Trajectory:
    return Trajectory.multisine(amplitude, seconds, frequencies=(0.4, 1.5), rest=0.1, kind=kind)


def report(folder: Path) -> dict:
    return json.loads((folder / "run_1.json").read_text())


def stored(folder: Path) -> dict[str, np.ndarray]:
    table = pq.read_table(folder / "run_1.parquet")
    return {name: table[name].to_numpy() for name in table.column_names}


# ---- the bus itself, through the unmodified SDK


def test_a_late_answer_is_never_taken_for_that_of_another_register(servo):
    """A register of one byte is asked after samples and after others, whose answers come late."""
    bus = Bus(servo.address, 1_000_000, [1], "sync")
    bus.expect(0.001)
    firmware = bus.get(1, x.FIRMWARE)
    servo.order("late 0.015 0.1")
    since = time.monotonic()
    read: list[tuple[int, int]] = []
    try:
        for _ in range(100):
            bus.read()
            read.append((bus.get(1, x.HARDWARE_ERROR), bus.get(1, x.FIRMWARE)))
    finally:
        servo.order("late 0 0")
    assert len(servo.log("late", since=since)) > 10
    assert set(read) == {(0, firmware)}


@pytest.mark.parametrize("form", ["sync", "bulk", "fast"])
def test_every_form_of_question_reads_the_memory(three, form):
    bus = Bus(three.address, 1_000_000, [1, 2, 7], form)
    since = time.monotonic()
    blocks = bus.read()
    assert blocks is not None and bus.lost == {}
    truth = {e["id"]: e for e in three.log("read", since=since)}
    for identity, block in zip((1, 2, 7), blocks, strict=True):
        assert x.decode(block, x.TICK, 120) == truth[identity]["tick"]
        assert x.decode(block, x.PRESENT_POSITION, 120) == truth[identity]["position"]
        assert x.decode(block, x.PRESENT_VOLTAGE, 120) == 120
    bus.port.closePort()


def test_ping_errors_action_and_reboot(three):
    bus = Bus(three.address, 1_000_000, [1], "sync")
    sdk, port = bus.packets, bus.port
    assert bus.ping(1) == 1020 and bus.ping(9) is None
    found, result = sdk.broadcastPing(port)
    assert result == 0 and {i: list(v) for i, v in found.items()} == {
        1: [1020, 46],
        2: [1020, 46],
        7: [1020, 46],
    }
    bus.put(1, x.OPERATING_MODE, 0)
    bus.put(1, x.TORQUE_ENABLE, 1)
    assert (
        sdk.write1ByteTxRx(port, 1, x.OPERATING_MODE.address, 3)[1] == 7
    )  # access: locked while torque is on
    assert sdk.write2ByteTxRx(port, 1, x.GOAL_CURRENT.address, 1500)[1] == 6  # limit
    assert sdk.readTxRx(port, 1, 160, 2)[2] == 4  # range
    assert sdk.write2ByteTxRx(port, 1, x.TICK.address, 1)[1] == 7  # read only
    assert sdk.regWriteTxRx(port, 1, x.GOAL_CURRENT.address, 2, [9, 0]) == (0, 0)
    assert bus.get(1, x.GOAL_CURRENT) == 0
    sdk.action(port, 1)
    assert (
        bus.get(1, x.GOAL_CURRENT) == 9
    )  # the empty answer to `action`, unread so far, comes first
    sdk.action(port, 1)
    assert bus.ping(1) == 1020
    assert sdk.reboot(port, 1) == (0, 0) and bus.get(1, x.TORQUE_ENABLE) == 0
    bus.put(1, x.OPERATING_MODE, 3)
    bus.port.closePort()


@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55, 0x7E]), min_size=1, max_size=20))
@example([0xFF, 0xFF, 0xFD, 0xFF, 0xFD, 0xFD])
@example([0xFF, 0xFF, 0xFD, 0x00, 0xFF, 0xFF, 0xFD, 0x00])
def test_bytes_that_look_like_a_header_go_through(bus, content):
    assert bus.packets.writeTxRx(bus.port, 1, 200, len(content), content) == (0, 0)
    back, result, error = bus.packets.readTxRx(bus.port, 1, 200, len(content))
    # The SDK 4.1.0 removes stuffing also where FF FF FD FD was sent, and where FF FD FD was after
    # it removed some; what it then misses at the end is its own affair.
    sent = bytes(content)
    stuffed = sent.find(b"\xff\xff\xfd")
    if stuffed < 0 or not (
        sent[stuffed:].startswith(b"\xff\xff\xfd\xfd") or b"\xff\xfd\xfd" in sent[stuffed + 1 :]
    ):
        assert (list(back), result, error) == (content, 0, 0)


@pytest.fixture
def bus(three):
    made = Bus(three.address, 1_000_000, [1], "sync")
    yield made
    made.port.closePort()


# ---- recording


def check_against_log(folder: Path, emulator: Emulator, since: float) -> int:
    """Every stored row is a block that the servo really gave, at its own tick; returns how many."""
    truth = {(e["tick"], e["position"], e["current"]) for e in emulator.log("read", since=since)}
    at = {e["tick"]: e["time"] for e in emulator.log("read", since=since)}
    rows = stored(folder)
    amps = x.MODELS[1020][1]
    zero = report(folder)["devices"]["dynamixel"]["servos"][0]["zero_counts"]
    shifts = []
    for t, q, current in zip(rows["t"], rows["q"], rows["current"], strict=True):
        position, count = round(q / x.POSITION) + zero, round(current / amps)
        shifts.append([at[k[0]] - t for k in truth if k[1:] == (position, count)])
    assert all(shifts), "a row that the servo never gave"
    # One offset between the clocks puts every row at its own time, to a tick; the row with the
    # fewest twins offers it.
    offsets = min(shifts, key=len)
    assert (
        min(max(min(abs(s - c) for s in found) for found in shifts) for c in offsets) < 2 * x.TICK_S
    )
    return len(rows["t"])


def test_bad_answers_are_counted_and_never_stored(servo, tmp_path):
    """3 % corrupt, 3 % silent and 3 % late answers while the servo moves."""
    for order in ("crc 0.03", "silent 0.03", "late 0.015 0.03"):
        servo.order(order)
    since = time.monotonic()
    try:
        result = record(
            Dynamixel(servo.address, mode="current", rate=RATE),
            tmp_path / "out",
            play=path(seconds=3.0),
            live=True,
            limits=LIMITS,
        )
    finally:
        for order in ("crc 0", "silent 0", "late 0 0"):
            servo.order(order)
    assert result.complete and check_against_log(tmp_path / "out", servo, since) > 200
    losses = next(e["losses"] for e in report(tmp_path / "out")["events"] if "losses" in e)
    made = servo.log("corrupted", "silenced", "late", since=since)
    assert (
        len(made) > 5
        and sum(losses.values()) > 5
        and any("none of them stored" in n for n in result.notes)
    )
    rows = stored(tmp_path / "out")
    assert np.all(np.diff(rows["t"]) > 0)
    goals = {signed(e["data"]) for e in writes(servo.log(since=since), x.GOAL_CURRENT.address)}
    told = pq.read_table(tmp_path / "out" / "run_1.commands.parquet")
    counts = np.round(told["current_cmd"].to_numpy() / x.MODELS[1020][1])
    assert set(counts) <= goals | {0} and len(counts) > 100
    # What was told between two rows keeps its sum, also where answers were lost.
    t, at, held = rows["t"], told["t"].to_numpy(), told["current_cmd"].to_numpy()
    fine = np.arange(t[0], t[-1], 1e-4)
    steps = np.where(
        fine < at[0], 0.0, held[np.maximum(np.searchsorted(at, fine, side="right") - 1, 0)]
    )
    assert np.sum(rows["current_cmd"][:-1] * np.diff(t)) == pytest.approx(
        np.sum(steps) * 1e-4, abs=1e-3
    )


def test_time_goes_on_where_the_counter_wraps(servo, tmp_path):
    servo.order("wrap_in 1.2")
    result = record(Dynamixel(servo.address, rate=RATE), tmp_path / "out", 1.5)
    t = stored(tmp_path / "out")["t"]
    ticks = [e["tick"] for e in servo.log("read")][-len(t) :]
    assert min(ticks) < 1000 < 32000 < max(ticks), "the counter did not wrap in this recording"
    assert (
        result.complete
        and np.all(np.diff(t) > 0)
        and t[-1] == pytest.approx(1.5, abs=0.2 + SLACK_S)
    )


def test_the_dataset_is_what_the_servo_did(servo, tmp_path):
    since = time.monotonic()
    result = record(
        Dynamixel(servo.address, mode="position", rate=RATE, zero="here"),
        tmp_path / "out",
        play=path("position", amplitude=0.4),
        live=True,
        limits=LIMITS,
        constants={"supply_voltage": 12.0},
    )
    assert result.complete
    data = load_dataset(tmp_path / "out", check_model=False)
    (run,) = data.experiments
    assert [c.name for c in data.inputs] == ["q_cmd"] and [
        (c.name, c.resolution) for c in data.outputs
    ] == [("q", x.POSITION)]
    assert np.max(np.abs(run.u[:, 0] - run.y[:, 0])) < 0.25 and run.constants == {
        "supply_voltage": 12.0
    }
    assert run.auxiliary["voltage"][0] == pytest.approx(12.0) and run.auxiliary["temperature"][
        0
    ] == pytest.approx(308.15)
    log = servo.log(since=since)
    order = [(e["address"], e["data"][0] > 0) for e in writes(log)]
    assert order.index((98, True)) < order.index((64, True)), (
        "the watchdog is set before torque is on"
    )
    assert writes(log, 64)[-1]["data"] == [0] and writes(log, 98)[-1]["data"] == [0]


def test_a_current_stays_a_current_unless_a_gain_is_stated(servo, tmp_path):
    def device():
        return Dynamixel(servo.address, mode="current", rate=RATE)

    with pytest.raises(
        UsageError, match="needs the torque 'tau', and the device has a current.*State the gain"
    ):
        record(device(), tmp_path / "out", play=path(), live=True, model="pendulum")
    record(
        device(),
        tmp_path / "out",
        play=path(),
        live=True,
        model="pendulum",
        gain=1.77,
        limits=LIMITS,
    )
    data = load_dataset(tmp_path / "out")
    rows = stored(tmp_path / "out")
    assert data.model is not None and data.model.name == "pendulum"
    assert "current_cmd" in rows and np.max(np.abs(data.experiments[0].u[:, 0])) == pytest.approx(
        1.77 * np.max(np.abs(rows["current_cmd"])), rel=1e-9
    )


PENDULUM = """<mujoco><worldbody><body>
  <joint name="servo" axis="0 1 0"/><inertial pos="0 0 -0.1" mass="0.4" diaginertia="1e-3 1e-3 1e-3"/>
</body></worldbody></mujoco>"""


def test_a_recording_for_a_robots_file_names_its_joint_and_holds_the_file(servo, tmp_path):
    robot = tmp_path / "pendulum.xml"
    robot.write_text(PENDULUM)
    device = Dynamixel(servo.address, mode="current", rate=RATE)
    out = tmp_path / "out"
    record(device, out, play=path(), live=True, model=str(robot), gain=1.77, limits=LIMITS)
    robot.unlink()
    data = load_dataset(out)
    assert data.model is not None and data.model.name == "robot"
    assert data.input_names == ["servo_tau"] and data.output_names == ["servo"]
    told = 1.77 * np.max(np.abs(stored(out)["current_cmd"]))
    assert np.max(np.abs(data.experiments[0].u[:, 0])) == pytest.approx(told, rel=1e-9)


def test_without_live_nothing_is_written(servo, tmp_path):
    since = time.monotonic()
    result = record(
        Dynamixel(servo.address, mode="current", rate=RATE), tmp_path / "out", play=path()
    )
    assert result.dry_run and not result.complete
    record(Dynamixel(servo.address, rate=RATE), tmp_path / "watched", 0.3)
    assert writes(servo.log(since=since)) == [] and not (tmp_path / "out").exists()


def test_three_servos_in_one_row(three, tmp_path):
    play = Trajectory.multisine(
        [0.3, 0.2, 0.1], 1.5, frequencies=(0.5, 1.5), rest=0.1, kind="velocity"
    )
    device = Dynamixel(three.address, [1, 2, 7], mode="velocity", rate=50.0)
    record(device, tmp_path / "out", play=play, live=True, limits=LIMITS)
    rows = stored(tmp_path / "out")
    assert {"q1", "q2", "q3", "qd1_cmd", "qd2_cmd", "qd3_cmd", "current3"} <= set(rows)
    assert np.ptp(rows["qd1_cmd"]) > np.ptp(rows["qd2_cmd"]) > np.ptp(rows["qd3_cmd"]) > 0


# ---- faults


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("overload", "hardware error: overload"),
        ("unplug", "the port is gone"),
        ("silent 1", "no (data|valid answer) for"),
    ],
)
def test_a_fault_is_one_sentence_and_torque_is_off(tmp_path, fault, words):
    servo = Emulator.servo(tmp_path)
    ordered: list[float] = []

    def progress(stage, done, total, text):
        if done >= 1 and not ordered:
            ordered.append(servo.order(fault))

    try:
        with pytest.raises(HardwareError, match=words) as caught:
            record(
                Dynamixel(servo.address, mode="current", rate=RATE),
                tmp_path / "out",
                play=path(seconds=6.0),
                live=True,
                limits=Limits(data_age=0.4),
                progress=progress,
            )
        about = report(tmp_path / "out")
        seen = next(e for e in about["events"] if e["kind"] == "fault")
        assert seen["host"] - ordered[0] < 0.6 + SLACK_S
        assert "\n" not in str(caught.value) and not about["complete"] and about["rows"] > 30
        later = servo.log(since=ordered[0])
        if fault == "unplug":
            assert "watchdog" in next(e["text"] for e in about["events"] if e["kind"] == "stop")
            servo.wait_for(lambda log: any(e["what"] == "watchdog" for e in log), 3.0)
        else:
            assert any(e["data"] == [0] for e in writes(later, 64)) or fault == "overload"
            assert 0 in [signed(e["data"]) for e in writes(later, x.GOAL_CURRENT.address)]
    finally:
        servo.close()


COMMANDED = 150  # cycles of 10 ms before a fault


def run_cli(servo: Emulator, folder: Path) -> subprocess.Popen:
    play = path(seconds=20.0)
    np.savetxt(
        folder / "path.csv",
        np.column_stack([play.t, play.values]),
        delimiter=",",
        header="t,current_cmd",
        comments="",
    )
    (folder / "limits.toml").write_text("data_age = 0.3\n")
    command = [
        sys.executable,
        "-m",
        "jaxid.cli",
        "record",
        "dynamixel",
        "--port",
        servo.address,
        "--id",
        "1",
        "--rate",
        "100",
    ]
    command += [
        "--mode",
        "current",
        "--play",
        str(folder / "path.csv"),
        "--live",
        "--limits",
        str(folder / "limits.toml"),
    ]
    before = len(writes(servo.log(), x.GOAL_CURRENT.address))
    process = subprocess.Popen(
        [*command, "--out", str(folder / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    servo.wait_for(lambda log: len(writes(log, x.GOAL_CURRENT.address)) > before + COMMANDED)
    return process


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_the_end_of_the_recorder_stops_the_servo(servo, tmp_path, number):
    process = run_cli(servo, tmp_path)
    sent = time.monotonic()
    process.send_signal(number)

    def off(log):
        return [e for e in writes(log, 64) if e["at"] >= sent and e["data"] == [0]]

    servo.wait_for(lambda log: bool(off(log)), 3.0)
    after = off(servo.log())[0]["at"] - sent
    print(f"torque off after {1e3 * after:.0f} ms")
    assert after < 0.05 + SLACK_S
    process.communicate(timeout=20)
    if number == signal.SIGKILL:
        recover(tmp_path / "out")
    else:
        assert process.returncode == 130
    about = report(tmp_path / "out")
    # rows go to disk every 0.5 s: SIGKILL takes what came since, with as much again for a machine
    # that is busy
    assert not about["complete"] and about["rows"] > COMMANDED - 100


def test_the_end_of_the_driver_leaves_the_watchdog_of_the_servo(servo, tmp_path):
    process = run_cli(servo, tmp_path)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    (driver,) = [
        int(c) for c in children if "dynamixel.driver" in Path(f"/proc/{c}/cmdline").read_text()
    ]
    sent = time.monotonic()
    os.kill(driver, signal.SIGKILL)
    servo.wait_for(lambda log: any(e["what"] == "watchdog" and e["at"] >= sent for e in log), 3.0)
    assert servo.log("watchdog", since=sent)[0]["at"] - sent < 0.3 + 0.02 + SLACK_S
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 1 and "SIGKILL" in errors and "rows up to then" in errors


# ---- nothing beyond a limit

NUMBER = st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.floats(-400, 400))
BOUNDS = {"lower": [-200], "upper": [150], "largest_step": [40]}


class Moves:
    """A driver that plays tables of counts, and is started again after one was refused."""

    def __init__(self, port: str):
        self.port, self.driver, self.last = port, None, 0

    def play(self, rows) -> str:
        if self.driver is None:
            self.driver, self.last = Driver("jaxid.hardware.dynamixel.driver", "test"), 0
            self.driver.ask(
                "open",
                "opened",
                10.0,
                port=self.port,
                baud=1_000_000,
                ids=[1],
                rate=200.0,
                form="sync",
            )
            self.driver.send("begin")
            self.driver.ask("arm", "armed", 10.0, mode="current", data_age=1.0)
        try:
            hand_over(self.driver, rows)
            self.driver.ask("play", "done", 5.0, step=0.005, start=[self.last], **BOUNDS)
        except HardwareError as error:
            self.close()
            return str(error)
        finally:
            if self.driver is not None:
                self.driver.messages()
        return ""

    def close(self) -> None:
        if self.driver is not None:
            self.driver.stop("over", 2.0)
            self.driver.close()
            self.driver = None


@pytest.fixture
def moves(servo):
    made = Moves(servo.address)
    yield made
    made.close()


@settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(rows=st.lists(st.lists(NUMBER, min_size=1, max_size=1), min_size=1, max_size=8))
def test_nothing_beyond_a_limit_reaches_the_wire(servo, moves, rows):
    since = time.monotonic()
    refused = moves.play(rows)
    good = next((k for k, row in enumerate(rows) if not np.isfinite(row[0])), len(rows))
    assert ("refused" in refused) == (good < len(rows)), refused
    sent = [signed(e["data"]) for e in writes(servo.log(since=since), x.GOAL_CURRENT.address)]
    assert all(-200 <= v <= 150 for v in sent)
    goes_on = (
        sent[:-1] if refused else sent
    )  # what ends a refused path is the goal zero of the stop
    assert all(abs(a - b) <= 40 for a, b in zip(goes_on, goes_on[1:], strict=False))
    moves.last = sent[-1] if sent else moves.last


# ---- long paths


def test_a_path_of_any_length_begins(servo, tmp_path):
    """80,000 rows go over and play; the end is not waited for."""
    play = Trajectory.multisine(
        0.3, 80_000 / RATE, frequencies=(0.4, 1.5), rest=0.1, kind="current", rate=200.0
    )
    since = time.monotonic()

    def progress(stage, done, total, text):
        moved = {
            signed(e["data"]) for e in writes(servo.log(since=since), x.GOAL_CURRENT.address)
        } - {0}
        if len(moved) > 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record(
            Dynamixel(servo.address, mode="current", rate=RATE),
            tmp_path / "out",
            play=play,
            live=True,
            limits=Limits(data_age=2.0),
            progress=progress,
        )
    about = report(tmp_path / "out")
    assert about["end_reason"] == "interrupted" and any(
        e.get("name") == "play_start" for e in about["events"]
    )
    assert writes(servo.log(since=since), 64)[-1]["data"] == [0]


def test_a_silence_that_is_allowed_ends_nothing(servo, tmp_path):
    """The driver's process stands still for less than `data_age`, as on a computer that has too
    much to do.
    """
    since = time.monotonic()

    def pause() -> None:
        servo.wait_for(
            lambda log: (
                len([e for e in writes(log, x.GOAL_CURRENT.address) if e["at"] >= since]) > 20
            )
        )
        (driver,) = [
            p
            for p in psutil.Process().children()
            if any("dynamixel.driver" in word for word in p.cmdline())
        ]
        driver.suspend()
        time.sleep(1.0)
        driver.resume()

    pausing = threading.Thread(target=pause)
    pausing.start()
    limits = Limits(data_age=2.0)
    result = record(
        Dynamixel(servo.address, mode="current", rate=RATE),
        tmp_path / "out",
        play=path(),
        live=True,
        limits=limits,
    )
    pausing.join()
    assert result.complete and report(tmp_path / "out")["complete"]
    assert np.diff(stored(tmp_path / "out")["t_host"]).max() > 0.9


# ---- before recording


def test_a_second_recorder_is_told_and_the_first_goes_on(servo, tmp_path, capsys):
    first = Bus(servo.address, 1_000_000, [1], "sync")
    before = first.read()
    arguments = [
        "record",
        "dynamixel",
        "--port",
        servo.address,
        "--id",
        "1",
        "--seconds",
        "1",
        "--out",
        str(tmp_path / "out"),
    ]
    assert main(arguments) == 2
    assert f"port {servo.address} is in use by another program" in capsys.readouterr().err
    after = [first.read() for _ in range(5)]
    first.port.closePort()
    assert before and all(after) and first.lost == {} and not (tmp_path / "out").exists()
    assert main([*arguments, "--rate", "20"]) == 0


def test_what_slows_a_line_down_is_said_before(tmp_path):
    servo = Emulator.servo(tmp_path, "--return-delay", "250", "--baud", "57600")
    try:
        with pytest.raises(
            UsageError, match="200 Hz cannot be reached: servo 1 waits 500 us.*57600 baud is slow"
        ):
            record(Dynamixel(servo.address, baud=57600, rate=200.0), tmp_path / "out", 0.5)
        with pytest.raises(
            UsageError, match="does not answer on .* at 1000000 baud; it does at 57600 baud"
        ):
            record(Dynamixel(servo.address), tmp_path / "out", 0.5)
        with pytest.raises(UsageError, match="servo 5 does not answer .*check its id"):
            record(Dynamixel(servo.address, 5, baud=57600), tmp_path / "out", 0.5)
    finally:
        servo.close()


def test_a_port_that_is_not_there(tmp_path):
    with pytest.raises(UsageError, match="cannot be opened"):
        record(Dynamixel("/dev/nowhere"), tmp_path / "out", 0.5)


@pytest.mark.parametrize(
    ("settings_", "words"),
    [
        ({"ids": [1, 1]}, "different numbers"),
        ({"mode": "torque"}, "mode is 'torque'"),
        ({"form": "quick"}, "form is 'quick'"),
        ({"rate": 5000.0}, "rate of 5000"),
        ({"zero": "there"}, "zero is 'there'"),
    ],
)
def test_wrong_words(settings_, words):
    with pytest.raises(UsageError, match=words):
        Dynamixel("/dev/null", **settings_)


@pytest.mark.skipif(
    "JAXID_DYNAMIXEL_PORT" not in os.environ, reason="not run: JAXID_DYNAMIXEL_PORT names no servo"
)
def test_a_real_servo_is_recorded(tmp_path):
    """Watches only; nothing moves. JAXID_DYNAMIXEL_BAUD and JAXID_DYNAMIXEL_ID where they differ
    from 1000000 and 1.
    """
    device = Dynamixel(
        os.environ["JAXID_DYNAMIXEL_PORT"],
        int(os.environ.get("JAXID_DYNAMIXEL_ID", "1")),
        baud=int(os.environ.get("JAXID_DYNAMIXEL_BAUD", "1000000")),
        rate=50.0,
    )
    assert record(device, tmp_path / "out", 5.0).complete
