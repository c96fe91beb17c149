"""Recording and moving a UR: the real ur_rtde against the emulator, with every fault it can
order.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
import tomllib
import tty
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, HealthCheck, settings, strategies as st

from emulators import Emulator, hand_over, PATIENT_S, servoing, SLACK_S, stops
from jaxid.base.errors import UsageError
from jaxid.cli.app import main
from jaxid.data.io import load_dataset
from jaxid.hardware import HardwareError, Limits, record, recover, SensorSpec, Trajectory, UR
from jaxid.hardware.link import Driver
from jaxid.hardware.ur.rtde import RTDEReader


pytestmark = pytest.mark.realtime

pytest.importorskip("rtde_control", reason="ur_rtde has no wheel for this Python")

#: `JAXID_HARDWARE_SECONDS=60` runs the recordings as long as the figures in the documentation.
SECONDS = float(os.environ.get("JAXID_HARDWARE_SECONDS", "3"))
LIMITS = Limits(data_age=PATIENT_S)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    emulator = Emulator.ur(tmp_path_factory.mktemp("ur"))
    yield emulator
    emulator.close()


def path(seconds: float = SECONDS, amplitude: float = 0.3) -> Trajectory:
    return Trajectory.multisine([amplitude] * 6, seconds, frequencies=(0.3, 1.0), rest=0.1)


def report(folder: Path) -> dict:
    return json.loads((folder / "run_1.json").read_text())


def test_nothing_is_lost_while_the_robot_moves(robot, tmp_path):
    """Beside it ur_rtde's own file recording, which loses samples without a word: its count is
    printed, not required.
    """
    code = (
        "import rtde_receive, sys, time;"
        "r = rtde_receive.RTDEReceiveInterface(sys.argv[1], 500.0, ['timestamp', 'actual_q']);"
        "r.startFileRecording(sys.argv[2], ['timestamp', 'actual_q']); time.sleep(float(sys.argv[3])); r.stopFileRecording()"
    )
    beside = subprocess.Popen(
        [sys.executable, "-c", code, robot.address, str(tmp_path / "own.csv"), str(SECONDS)]
    )
    result = record(UR(robot.address), tmp_path / "out", play=path(), live=True, limits=LIMITS)
    assert beside.wait(30) == 0
    t = pq.read_table(tmp_path / "out" / "run_1.parquet")["t"].to_numpy()
    assert result.complete and (result.lost, result.duplicated, result.gaps) == (0, 0, ())
    assert np.all(np.diff(t) > 0) and len(t) == round(t[-1] * 500) + 1 and t[-1] > SECONDS
    own = [
        float(line.split(",")[0]) for line in (tmp_path / "own.csv").read_text().splitlines()[1:]
    ]
    step = np.diff(np.unique(own))
    missing = int(np.sum(np.round(step * 500) - 1))
    print(
        f"ours: {len(t)} rows, 0 lost; ur_rtde's file: {len(own)} rows, {missing} lost, {len(own) - len(step) - 1} duplicated"
    )


def test_the_dataset_holds_what_the_robot_did(robot, tmp_path):
    play = path(2.0)
    record(UR(robot.address), tmp_path / "out", play=play, live=True, limits=LIMITS)
    data = load_dataset(tmp_path / "out", check_model=False)
    (run,) = data.experiments
    assert run.at_rest and [c.name for c in data.inputs] == [f"current{j}" for j in range(1, 7)]
    assert [c.name for c in data.outputs] == [f"q{j}" for j in range(1, 7)]
    told = run.auxiliary["q2_cmd"]
    assert np.max(np.abs(told - run.y[:, 1])) < 0.02
    assert np.ptp(told) == pytest.approx(np.ptp(play.values[:, 1]), rel=0.1)
    assert run.auxiliary["temperature1"][0] == pytest.approx(303.15) and np.all(
        run.auxiliary["speed_scaling"] == 1
    )
    about = report(tmp_path / "out")
    assert (
        about["complete"]
        and about["excitation"]["sha256"] == play.sha256
        and about["provenance"].startswith("emulated")
    )
    assert {"ur10"} == set(about["clocks"]) and about["limits"]["data_age"] == PATIENT_S


def test_without_live_not_one_byte_moves(robot, tmp_path):
    since = time.monotonic()
    result = record(UR(robot.address), tmp_path / "out", play=path())
    assert result.dry_run and "Nothing was moved" in result.text
    record(UR(robot.address), tmp_path / "watched", 0.3)
    assert robot.log("command", "script", "dashboard", "halt", since=since) == []
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("drop", "closed the connection"),
        ("stall 3", "no data for"),
        ("truncated record", "unfinished package"),
        ("short record", "where .* were agreed"),
        ("wrong_id record", "recipe 99"),
        ("malformed", "malformed package"),
        ("protective_stop", "protective stop|is a program or a stop in the way"),
        ("speed 0.5", "speed slider 50 %"),
    ],
)
def test_a_fault_is_one_sentence_and_the_robot_stands(robot, tmp_path, fault, words):
    device = UR(robot.address)
    ordered: list[float] = []

    def progress(stage, done, total, text):
        if done >= 1 and not ordered:
            ordered.append(robot.order(fault))

    try:
        with pytest.raises(HardwareError, match=words) as caught:
            record(
                device,
                tmp_path / "out",
                play=path(6.0),
                live=True,
                limits=Limits(data_age=0.5),
                progress=progress,
            )
        about = report(tmp_path / "out")
        seen = next(e for e in about["events"] if e["kind"] == "fault")
        assert seen["host"] - ordered[0] < 0.6 + SLACK_S
        assert (
            "\n" not in str(caught.value)
            and about["complete"] is False
            and str(caught.value) == about["end_reason"]
        )
        rows = pq.read_table(tmp_path / "out" / "run_1.parquet")["t_host"].to_numpy()
        assert len(rows) > 300
        # Rows go on until the fault: the last one is at most the silence before it away.
        assert ordered[0] - (seen["host"] - seen["t"]) - rows[-1] < 0.1 + SLACK_S
        assert stops(robot.log(since=ordered[0])), "the motion was not stopped"
        time.sleep(0.1)
        assert servoing(robot.log(since=time.monotonic() - 0.05)) == 0
    finally:
        for order in ("speed 1", "clear", "stall 0"):
            robot.order(order)


def test_a_mute_server_is_recognised(robot, tmp_path):
    robot.order("mute")
    began = time.monotonic()
    try:
        with pytest.raises(HardwareError, match="does not answer within 0.5 s"):
            record(UR(robot.address), tmp_path / "out", 1.0)
    finally:
        robot.order("mute 0")
    assert time.monotonic() - began < 0.6 + SLACK_S and not (tmp_path / "out").exists()


def test_a_lost_control_line_does_not_restart_the_robot(robot, tmp_path):
    """ur_rtde would connect again and upload its program by itself after 4 s; by then its process
    is gone.
    """
    ordered: list[float] = []

    def progress(stage, done, total, text):
        if done >= 1 and not ordered:
            ordered.append(robot.order("drop control"))

    with pytest.raises(HardwareError, match="driver"):
        record(
            UR(robot.address),
            tmp_path / "out",
            play=path(6.0),
            live=True,
            limits=Limits(data_age=0.5),
            progress=progress,
        )
    until = time.monotonic() + SLACK_S
    while not stops(robot.log(since=ordered[0])) and time.monotonic() < until:
        time.sleep(0.1)
    time.sleep(0.5)
    later = robot.log(since=ordered[0])
    assert stops(later) and not [e for e in later if e["what"] == "script"]


def run_cli(robot: Emulator, out: Path, *more: str) -> subprocess.Popen:
    file = out.parent / "path.csv"
    play = path(20.0)
    names = ",".join(f"q{j}" for j in range(1, 7))
    np.savetxt(
        file,
        np.column_stack([play.t, play.values])[::5],
        delimiter=",",
        header="t," + names,
        comments="",
    )
    limits = out.parent / "limits.toml"
    limits.write_text(f"data_age = {PATIENT_S}\n")
    command = [
        sys.executable,
        "-m",
        "jaxid.cli",
        "record",
        "ur10",
        "--host",
        robot.address,
        "--out",
        str(out),
    ]
    command += ["--play", str(file), "--live", "--limits", str(limits), *more]
    before = servoing(robot.log())

    # as a shell starts a background job
    def background():
        return signal.signal(signal.SIGINT, signal.SIG_IGN)

    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=background
    )
    robot.wait_for(lambda log: servoing(log) > before + 60)
    return process


def first_stop(robot: Emulator, since: float) -> float:
    robot.wait_for(lambda log: any(e["at"] >= since for e in stops(log)), 3.0)
    after = next(e["at"] for e in stops(robot.log(since=since))) - since
    print(f"stopped after {1e3 * after:.0f} ms")
    return after


def test_an_interrupt_stops_the_robot_at_once(robot, tmp_path):
    process = run_cli(robot, tmp_path / "out")
    sent = time.monotonic()
    process.send_signal(signal.SIGINT)
    after = first_stop(robot, sent)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 130 and "interrupted" in errors and "Traceback" not in errors
    assert after < 0.05 + SLACK_S
    about = report(tmp_path / "out")
    assert (
        about["complete"] is False and about["end_reason"] == "interrupted" and about["rows"] > 200
    )


def test_a_killed_recorder_stops_the_robot_and_loses_at_most_a_second(robot, tmp_path):
    process = run_cli(robot, tmp_path / "out")
    time.sleep(1.0)
    sent = time.monotonic()
    process.kill()
    assert first_stop(robot, sent) < 0.05 + SLACK_S
    process.communicate()
    (result,) = recover(tmp_path / "out")
    assert not result.complete and "without closing" in result.end_reason
    rows = pq.read_table(tmp_path / "out" / "run_1.parquet")["t_host"].to_numpy()
    started = report(tmp_path / "out")["started_monotonic"]
    assert sent - started - (rows[-1] - rows[0]) < 1.0 + SLACK_S and result.lost == 0
    assert load_dataset(tmp_path / "out", check_model=False).experiments
    with pytest.raises(UsageError, match="no unfinished recording"):
        recover(tmp_path / "out")


def driver_of(process: subprocess.Popen) -> int:
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    (child,) = [int(c) for c in children if "ur.driver" in Path(f"/proc/{c}/cmdline").read_text()]
    return child


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_dead_or_hung_driver_stops_the_robot(robot, tmp_path, number):
    process = run_cli(robot, tmp_path / "out")
    sent = time.monotonic()
    os.kill(driver_of(process), number)
    # Killed: its line closes at once. Hung: the recorder misses its word, ends it and asks the
    # dashboard.
    assert (
        first_stop(robot, sent)
        < (0.2 if number == signal.SIGKILL else 1.5 * PATIENT_S + 0.3) + SLACK_S
    )
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 1 and "driver" in errors and "rows up to then are in" in errors
    rows = report(tmp_path / "out")
    assert rows["rows"] > 200 and rows["lost"] == 0


def test_a_path_of_any_length_begins(robot, tmp_path):
    """600 s with 500 commands a second go over while samples come; the end is not waited for."""
    play = Trajectory.multisine([0.3] * 6, 600.0, frequencies=(0.1, 0.6), rest=0.1)
    seen: list[int] = []

    def progress(stage, done, total, text):
        seen.append(servoing(robot.log(since=began)))
        if seen[-1] > 100:
            raise KeyboardInterrupt

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        device = UR(robot.address, command_rate=500.0)
        record(
            device,
            tmp_path / "out",
            play=play,
            live=True,
            limits=Limits(data_age=2.0),
            progress=progress,
        )
    about = report(tmp_path / "out")
    assert about["end_reason"] == "interrupted" and about["lost"] == 0 and about["rows"] > 300


def test_a_pause_of_this_computer_is_named(robot, tmp_path):
    process = run_cli(robot, tmp_path / "out")
    sent = time.monotonic()
    os.kill(
        process.pid, signal.SIGSTOP
    )  # as the recorder sees it, a computer that does other things
    assert first_stop(robot, sent) < PATIENT_S + 0.2 + SLACK_S
    time.sleep(max(0.0, sent + 1.5 - time.monotonic()))
    os.kill(process.pid, signal.SIGCONT)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == 1 and "rows up to then are in" in errors
    assert "this computer was busy for 1." in errors and "data_age allows 0.8 s" in errors, errors
    assert report(tmp_path / "out")["lost"] == 0


def test_a_program_that_runs_is_not_replaced(robot, tmp_path):
    first = Driver("jaxid.hardware.ur.driver", "first")
    try:
        first.ask("arm", "armed", 20.0, host=robot.address, frequency=500.0, data_age=2.0)
        since = time.monotonic()
        with pytest.raises(UsageError, match="a program is running on the robot"):
            record(UR(robot.address), tmp_path / "out", play=path())
        assert not robot.log("script", since=since)
    finally:
        first.stop("over", 5.0)
        first.close()


def test_an_exception_of_the_user_stops_the_robot(robot, tmp_path):
    raised: list[float] = []

    def progress(stage, done, total, text):
        if done >= 1:
            raised.append(time.monotonic())
            raise RuntimeError("a plot failed")

    with pytest.raises(RuntimeError, match="a plot failed"):
        record(
            UR(robot.address),
            tmp_path / "out",
            play=path(6.0),
            live=True,
            limits=LIMITS,
            progress=progress,
        )
    assert first_stop(robot, raised[0]) < 0.05 + SLACK_S
    assert report(tmp_path / "out")["end_reason"] == "a plot failed"


NUMBER = st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.floats(-8, 8))
BOUNDS = {"lower": [-1.0] * 6, "upper": [0.5, 1, 1, 1, 1, 1], "largest_step": [0.02] * 6}


class Moves:
    """A driver that plays tables, and is started again after one was refused."""

    def __init__(self, host: str):
        self.host, self.driver, self.last = host, None, [0.0] * 6

    def play(self, rows) -> str:
        """What was refused, or nothing."""
        if self.driver is None:
            self.driver = Driver("jaxid.hardware.ur.driver", "test")
            self.driver.ask("arm", "armed", 10.0, host=self.host, frequency=500.0, data_age=1.0)
        try:
            hand_over(self.driver, rows)
            self.driver.ask(
                "play", "done", 5.0, step=0.004, start=self.last, lookahead=0.1, gain=300, **BOUNDS
            )
        except HardwareError as error:
            self.close()
            return str(error)
        return ""

    def close(self) -> None:
        if self.driver is not None:
            self.driver.stop("over", 2.0)
            self.driver.close()
            self.driver = None


@pytest.fixture
def moves(robot):
    made = Moves(robot.address)
    yield made
    made.close()


@settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(rows=st.lists(st.lists(NUMBER, min_size=6, max_size=6), min_size=1, max_size=8))
def test_nothing_beyond_a_limit_reaches_the_wire(robot, moves, rows):
    since, start = time.monotonic(), moves.last
    refused = moves.play(rows)
    good = next((k for k, row in enumerate(rows) if not np.all(np.isfinite(row))), len(rows))
    assert ("refused" in refused) == (good < len(rows)), refused
    sent = [e["values"] for e in robot.log("command", since=since) if e["name"] == "servoJ"]
    assert len(sent) == good
    for values, before in zip(sent, [start, *sent], strict=False):
        assert all(abs(a - b) <= 0.02 + 1e-9 for a, b in zip(values, before, strict=True))
        assert all(
            lo - 1e-9 <= v <= hi + 1e-9
            for v, lo, hi in zip(values, BOUNDS["lower"], BOUNDS["upper"], strict=True)
        )
    moves.last = sent[-1] if sent else start


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: Trajectory(p.t, p.values * 40), "q of joint 1 reaches .*the limit is 6.283 rad"),
        (lambda p: Trajectory(p.t / 40, p.values), "speed of joint .* the limit is 2.09 rad/s"),
        (lambda p: Trajectory(p.t, p.values[:, :5]), "has 5 joints, ur10 has 6"),
        (lambda p: Trajectory(p.t, p.values, "current"), "takes position commands"),
    ],
)
def test_a_path_beyond_limits_is_refused_before_anything_happens(robot, tmp_path, change, words):
    since = time.monotonic()
    with pytest.raises(UsageError, match=words):
        record(UR(robot.address), tmp_path / "out", play=change(path(2.0)), live=True)
    assert not (tmp_path / "out").exists() and not robot.log("command", "script", since=since)


def test_a_robot_that_is_slowed_down_is_not_moved(robot, tmp_path):
    robot.order("speed 0.7")
    since = time.monotonic()
    try:
        time.sleep(0.05)
        with pytest.raises(UsageError, match="slowed down .*speed slider 70 %"):
            record(UR(robot.address), tmp_path / "out", play=path(), live=True)
        watched = record(UR(robot.address), tmp_path / "watched", 0.2)
    finally:
        robot.order("speed 1")
    assert watched.complete and not robot.log("script", since=since)


def test_nobody_listening_and_an_unknown_variable(robot):
    with pytest.raises(UsageError, match="no connection"):
        RTDEReader("127.0.0.1", ["timestamp"], 500.0, port=1)
    with pytest.raises(UsageError, match="no variable nonsense"):
        RTDEReader(robot.address, ["timestamp", "nonsense"], 500.0)
    reader = RTDEReader(robot.address, ["timestamp"], 125.0, optional=["nonsense"])
    assert reader.names == ("timestamp",)
    reader.close()


def test_a_second_run_is_added(robot, tmp_path):
    record(UR(robot.address), tmp_path / "out", play=path(1.2, 0.1), live=True, limits=LIMITS)
    with pytest.raises(UsageError, match="--append"):
        record(UR(robot.address), tmp_path / "out", 0.3)
    second = record(
        UR(robot.address),
        tmp_path / "out",
        play=path(1.2, 0.05),
        live=True,
        limits=LIMITS,
        split="validation",
        append=True,
    )
    assert second.file == "run_2.parquet"
    data = load_dataset(tmp_path / "out", check_model=False)
    assert [(e.name, e.split) for e in data.experiments] == [
        ("run_1", "fit"),
        ("run_2", "validation"),
    ]


def test_a_serial_sensor_beside_the_robot(robot, tmp_path):
    """Lines at 200 Hz with a clock of their own; in the second run the sensor falls silent."""
    master, slave = os.openpty()
    tty.setraw(slave)
    (tmp_path / "tip.toml").write_text(
        f'name = "tip"\nport = "{os.ttyname(slave)}"\ncolumns = ["ms", "ax"]\ntime = {{ column = "ms", unit = "ms" }}\n'
        '[channels.tip]\ncolumn = "ax"\nunit = "m/s^2"\n'
    )
    spec, going = SensorSpec.read(tmp_path / "tip.toml"), threading.Event()
    going.set()

    def write():
        while going.is_set():
            now = time.monotonic()
            os.write(master, f"{1000 * (now - 5):.3f},{np.sin(now):.6f}\n".encode())
            time.sleep(0.005)

    writer = threading.Thread(target=write, daemon=True)
    writer.start()
    result = record(UR(robot.address), tmp_path / "out", 1.5, sensors=[spec])
    table = pq.read_table(tmp_path / "out" / "run_1.parquet")
    assert result.complete and len(table) > 500
    report_ = report(tmp_path / "out")
    host = table["t_host"].to_numpy() + report_["events"][-1]["host"] - report_["events"][-1]["t"]
    np.testing.assert_allclose(table["tip"].to_numpy(), np.sin(host), atol=0.02 + SLACK_S / 5)
    assert "drift" in report_["clocks"]["tip"]
    going.clear()
    writer.join()
    with pytest.raises(HardwareError, match="sensor tip has been silent"):
        record(UR(robot.address), tmp_path / "silent", 5.0, sensors=[spec])
    assert report(tmp_path / "silent")["rows"] > 200
    os.close(slave)
    os.close(master)


def test_everything_listens_on_loopback_only(robot):
    """Sockets of the emulator's process, from the kernel's own table."""
    inodes = {os.readlink(f) for f in Path(f"/proc/{robot.process.pid}/fd").iterdir() if f.exists()}
    listening = []
    for line in Path("/proc/net/tcp").read_text().splitlines()[1:]:
        fields = line.split()
        if fields[3] == "0A" and f"socket:[{fields[9]}]" in inodes:
            listening.append(int(fields[1].split(":")[0][6:8], 16))
    assert len(listening) == 5 and set(listening) == {127}
    with pytest.raises(subprocess.CalledProcessError):
        command = [
            sys.executable,
            "-m",
            "jaxid.cli",
            "emulate",
            "ur10",
            "--host",
            "0.0.0.0",
            "--plant",
            "ideal",
        ]  # noqa: S104
        subprocess.run(command, check=True, capture_output=True, timeout=20)


@pytest.mark.skipif(
    "JAXID_UR_HOST" not in os.environ, reason="not run: JAXID_UR_HOST names no URSim or robot"
)
def test_a_real_controller_is_recorded(tmp_path):
    """Watches only; nothing moves."""
    result = record(UR(os.environ["JAXID_UR_HOST"]), tmp_path / "out", 10.0)
    assert result.complete and result.lost == 0 and result.duplicated == 0


def test_the_command_records_what_an_emulator_sends(tmp_path):
    """As the README types it, with a robot's file that names one of the six joints."""
    emulator = Emulator.ur(tmp_path)
    robot, out = tmp_path / "robot.xml", tmp_path / "out"
    robot.write_text(
        """<mujoco><worldbody><body><joint name="lift" axis="0 1 0"/>
<inertial pos="0 0 -0.3" mass="20" diaginertia="0.6 0.6 0.1"/></body></worldbody></mujoco>
"""
    )
    words = ["record", "ur10", "--host", emulator.address, "--seconds", "2", "--out", str(out)]
    try:
        assert main([*words, "--model", str(robot), "--joint", "2"]) == 0
    finally:
        emulator.close()
    channels = tomllib.loads((out / "dataset.toml").read_text())["channels"]
    assert channels["lift"]["column"] == "q2" and channels["lift_cmd"]["column"] == "q2_cmd"
    assert (out / "robot.xml").is_file()
