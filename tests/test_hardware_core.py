"""The parts of a recording that need no device: limits, paths, clocks, rows on disk, sensors, the
command line.
"""

from __future__ import annotations

import json
import os
import socket
import struct
import threading
import time
import tty
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings, strategies as st

from emulators import hand_over
from jaxid.base.errors import UsageError
from jaxid.cli.app import main
from jaxid.data.io import load_dataset
from jaxid.hardware import HardwareError, Limits, recover, SensorSpec, Trajectory
from jaxid.hardware.channels import channel_map
from jaxid.hardware.clock import from_arrivals, from_signals, within_tick
from jaxid.hardware.dynamixel.tick import TickClock
from jaxid.hardware.limits import Clamp, Refused
from jaxid.hardware.link import Closed, Driver, farewell, Leash, Link, StopRequest
from jaxid.hardware.pauses import kept_from_running, Pauses, progress_said, waited
from jaxid.hardware.port import opened
from jaxid.hardware.preflight import refuse_size
from jaxid.hardware.recorder import Column, read_events, read_rows, Recorder, Stream
from jaxid.hardware.sensor import SerialSensor
from jaxid.hardware.transfer import PathTable, Sender
from jaxid.hardware.ur.rtde import DATA, RTDEReader
from jaxid.numerics.precision import float64


# ---- limits

FINITE = st.floats(-1e6, 1e6)


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.lists(st.floats(), min_size=2, max_size=2), max_size=30),
    FINITE,
    st.floats(1e-3, 10),
)
def test_whatever_is_asked_a_clamp_sends_small_finite_steps_inside(commands, start, step):
    clamp = Clamp([-1.0, -2.0], [1.0, 0.5], [step, 2 * step], [0.0, 0.0])
    before = (0.0, 0.0)
    for command in commands:
        try:
            sent = clamp(command)
        except Refused:
            assert not np.all(np.isfinite(command))
            assert clamp.last == before  # nothing is sent in its place
            continue
        assert np.all(np.isfinite(sent))
        assert (
            abs(sent[0] - before[0]) <= step + 1e-12
            and abs(sent[1] - before[1]) <= 2 * step + 1e-12
        )
        assert -1 <= sent[0] <= 1 and -2 <= sent[1] <= 0.5
        before = sent


def test_a_start_outside_the_bounds_is_led_back_in_steps():
    clamp = Clamp([-1.0], [1.0], [0.3], [2.0])
    assert [round(clamp([5.0])[0], 9) for _ in range(5)] == [
        1.7,
        1.4,
        1.1,
        1.0,
        1.0,
    ] and clamp.count == 5
    with pytest.raises(Refused):
        clamp([0.0, 0.0])


def test_limits_from_a_file(tmp_path):
    file = tmp_path / "limits.toml"
    file.write_text("speed = [1.0, 2.0]\nupper = 3\ndata_age = 0.2\n")
    limits = Limits.read(file).within(Limits(speed=(1.5,), lower=(-1.0,), upper=(4.0,)), 2)
    assert (limits.speed, limits.upper, limits.lower, limits.data_age) == (
        (1.0, 1.5),
        (3.0, 3.0),
        (-1.0, -1.0),
        0.2,
    )
    for text, words in [
        ("sped = 1", "no limit 'sped' .did you mean 'speed'"),
        ("speed = -1", "speed is -1; write numbers above 0"),
        ("speed = 'fast'", "speed is 'fast'"),
        ("speed = nan", "speed is nan"),
        ("data_age = 60", "write 0.02 to 2"),
        ("speed = ", "not readable as TOML"),
    ]:
        file.write_text(text)
        with pytest.raises(UsageError, match=words):
            Limits.read(file)
    with pytest.raises(UsageError, match="has 3 numbers for 2 joints"):
        Limits(speed=(1.0, 1.0, 1.0)).widened(2)


def test_a_measurement_beyond_a_limit_is_named():
    limits = Limits(lower=(-1.0,), upper=(1.0,), speed=(2.0,), current=(3.0,)).widened(2)
    assert limits.violation([0, 0.9], [0, 1.9], [0, -2.9]) is None
    assert "q2 = 1.2 rad is above its limit of 1 rad" in (limits.violation([0, 1.2], [0, 0]) or "")
    assert "qd1 = -3 rad/s is below its limit of -2" in (limits.violation([0, 0], [-3, 0]) or "")
    hot = Limits(temperature=(350.0,)).widened(2).violation([0, 0], [0, 0], [0, 0], [300, 351])
    assert "temperature2 = 351 K is above its limit of 350 K" in (hot or "")
    assert "current2 is nan" in (limits.violation([0, 0], [0, 0], [0, float("nan")]) or "")


# ---- paths


def test_a_path_is_read_from_files_and_folders(tmp_path):
    t = np.arange(200) * 0.01
    q = np.stack([0.1 * np.sin(t + j) for j in range(6)], axis=1)
    names = ",".join(f"q{j}_cmd" for j in range(1, 7))
    np.savetxt(
        tmp_path / "path.csv",
        np.column_stack([t + 5, q]),
        delimiter=",",
        header="t," + names,
        comments="",
    )
    play = Trajectory.read(tmp_path / "path.csv", 6)
    np.testing.assert_allclose(play.values, q, rtol=1e-9)
    assert (
        play.t[0] == 0 and play.duration == pytest.approx(1.99) and len(play.sampled(0.008)) == 250
    )

    from jaxid.data.dataset import Dataset
    from jaxid.data.io import save_dataset

    data = Dataset.from_arrays(
        t,
        {f"tau{j}": q[:, 0] for j in (1, 2)},
        {f"q{j}": q[:, j] for j in (1, 2)},
        name="excitation",
    )
    folder = save_dataset(data, tmp_path / "excitation")
    np.testing.assert_allclose(Trajectory.read(folder, 2).values, q[:, 1:3])
    for path, joints, words in [
        (tmp_path / "path.csv", 7, "no column 'q7_cmd'"),
        (tmp_path / "absent.csv", 1, "cannot be read"),
        (tmp_path / "nowhere", 1, "cannot be read"),
    ]:
        with pytest.raises(UsageError, match=words):
            Trajectory.read(path, joints)


@pytest.mark.parametrize(
    ("t", "values", "words"),
    [
        ([0, 1, 1], [0, 0, 0], "time does not rise at row 4"),
        ([0, 1, 2], [0, np.nan, 0], "row 3 holds a value that is not a number"),
        ([0], [0], "2 or more"),
    ],
)
def test_a_path_that_is_none(t, values, words):
    with pytest.raises(UsageError, match=words):
        Trajectory(np.array(t), np.array(values))


@pytest.mark.parametrize("seconds", [1.0, 2.0, 8.0])
def test_a_multisine_rests_at_both_ends_and_has_its_size(seconds):
    play = Trajectory.multisine(
        [0.5, 0.2], seconds, center=[1.0, 0.0], frequencies=(0.5, 2.0), rest=0.2
    )
    assert (
        np.ptp(play.values[:100], axis=0).max() < 1e-9
        and np.ptp(play.values[-100:], axis=0).max() < 1e-9
    )
    assert np.abs(play.values - [1.0, 0.0]).max(axis=0) == pytest.approx([0.5, 0.2])
    assert play.check(Limits(acceleration=(200.0,)), 0.008) == []


def saved(folder: Path, t: np.ndarray, values: np.ndarray) -> Trajectory:
    np.savetxt(
        folder / "path.csv",
        np.column_stack([t, values]),
        delimiter=",",
        header="t,q_cmd",
        comments="",
    )
    return Trajectory.read(folder / "path.csv")


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "ms"), (1e6, "us"), (1e9, "ns")])
@pytest.mark.parametrize("rate", [50.0, 500.0, 1000.0])
def test_a_time_that_is_not_in_seconds_is_recognised(tmp_path, factor, unit, rate):
    t = np.arange(300) / rate
    play = saved(tmp_path, factor * t, 0.1 * np.sin(t))
    assert f"rather {unit} than s: divide it by {factor:.0f}" in play.not_in_seconds()
    assert "row 3 comes" in play.not_in_seconds()
    assert Trajectory(t, np.sin(t)).not_in_seconds() == ""


def test_steps_that_are_held_for_seconds_are_a_path():
    t = np.arange(40) * 5.0
    assert Trajectory(t, 0.02 * np.arange(40), "current").not_in_seconds() == ""


@pytest.mark.parametrize("row", [2, 57, 58, 59, 60, 301])
@pytest.mark.parametrize("lasting", [False, True])
def test_a_jump_is_found_with_its_row(tmp_path, row, lasting):
    """In one row of 500 a second, whichever of them are sent; row numbers are those of the file."""
    t = np.arange(300) / 500
    q = 0.05 * np.sin(6 * t)
    k = row - 2
    q[k : None if lasting and k else k + 1] += 0.4
    speed = [p for p in saved(tmp_path, t, q).check(Limits(speed=(3.0,)), 0.008) if "speed" in p]
    found = {int(p.split("(row ")[1].split(")")[0]) for p in speed}
    assert found & {row, row + 1} and all(
        "the limit is" in p and "correct the row if it is a jump" in p for p in speed
    )


def test_what_is_commanded_first_and_last_counts_as_a_step():
    play = Trajectory(np.array([0.0, 1.0]), np.array([0.5, 0.5]), "velocity")
    problems = play.check(Limits(acceleration=(10.0,)), 0.01)
    assert (
        len(problems) == 2
        and "reaches 50 rad/s^2 at 0.000 s (row 2)" in problems[0]
        and "(row 3)" in problems[1]
    )
    assert play.check(Limits(acceleration=(51.0,)), 0.01) == []


@pytest.mark.parametrize("step", [0.002, 0.005, 0.008, 0.1, 0.3])
@pytest.mark.parametrize("duration", [0.3, 0.7, 1.0, 2.4])
def test_commands_have_their_step_and_the_end(step, duration):
    sent = Trajectory(np.array([0.0, duration]), np.array([0.0, duration])).sampled(step)[:, 0]
    assert sent[0] == 0 and sent[-1] == duration and np.allclose(np.diff(sent)[:-1], step)
    assert 1e-6 * step < np.diff(sent)[-1] <= step * (1 + 1e-9)


def test_a_held_current_is_sampled_as_held():
    play = Trajectory(np.array([0.0, 0.5, 1.0]), np.array([0.1, 0.4, 0.0]), "current")
    assert play.sampled(0.25)[:, 0].tolist() == [0.1, 0.1, 0.4, 0.4, 0.0]
    assert "current reaches 0.4 A at 0.5" in play.check(Limits(current=(0.3,)), 0.01)[0]


# ---- clocks


def test_drift_and_offset_from_arrivals():
    """Truth: the device runs 80 ppm slow and began 12.5 s later; delays are 0.3 ms and an
    exponential tail.
    """
    rng = np.random.default_rng(0)
    within = 0
    for _ in range(20):
        device = np.arange(5000) * 0.002
        host = 12.5 + (1 + 80e-6) * device + 3e-4 + rng.exponential(1e-3, len(device))
        clock = from_arrivals(device, host)
        assert abs(clock.offset - 12.5 - 3e-4) < 1e-4
        within += abs(clock.drift - 80e-6) < 2 * clock.drift_std
        np.testing.assert_allclose(clock.inverse(clock(device)), device, atol=1e-9)
    assert within >= 15


def test_a_recording_from_elsewhere_is_aligned_by_its_signal():
    """An accelerometer at 417 Hz, 3.2 s behind, 200 ppm fast, against the angle at 200 Hz."""
    rng = np.random.default_rng(1)
    f, phase = np.array([0.4, 0.9, 1.7, 2.9]), rng.uniform(0, 6, 4)

    def angle(t):
        return np.sum(np.sin(2 * np.pi * f * t[:, None] + phase) / f, axis=1)

    def bend(t):
        return np.sum(
            -((2 * np.pi * f) ** 2) * np.sin(2 * np.pi * f * t[:, None] + phase) / f, axis=1
        )

    t = np.arange(4000) / 200
    true = np.arange(6000) / 417 + 1.0
    other = (true - 3.2) / (1 + 200e-6)
    signal = 0.21 * bend(true) + 0.4 + 0.05 * rng.standard_normal(len(true))
    clock = from_signals(t, angle(t), other, signal, derivative=2)
    error = clock(other) - true
    assert np.abs(error).max() < 1e-3 and np.abs(error).max() < 5 * np.hypot(
        clock.offset_std, clock.drift_std * 20
    )
    with pytest.raises(ValueError, match="do not resemble"):
        from_signals(t, angle(t), other, rng.standard_normal(len(true)), derivative=2)


def test_a_tick_is_refined_and_never_left():
    rng = np.random.default_rng(2)
    true = 3.0 + np.cumsum(rng.uniform(0.0045, 0.0056, 2000))
    tick = np.floor(true * 1000) / 1000
    sent = 100 + true * (1 + 30e-6) - 2e-4 - rng.exponential(2e-5, 2000)
    fine, host, blur, asked = within_tick(
        tick, 1e-3, sent, sent + 2e-3 + rng.exponential(1e-3, 2000)
    )
    assert np.all((fine >= tick) & (fine < tick + 1e-3))
    assert np.std(fine - true) < 1.2e-4 < np.std(tick - true)
    assert np.abs(asked.inverse(sent) - fine).max() < 5e-4
    assert blur < 1.5e-4 and abs(host.drift - 30e-6) < 5 * host.drift_std


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    start=st.floats(0, 32.7),
    drift=st.floats(-1e-4, 1e-4),
    stale=st.lists(st.integers(20, 900), max_size=20),
)
def test_a_tick_clock_wraps_and_takes_no_old_answer(seed, start, drift, stale):
    """70 s at 14 Hz: two wraps; at the stale places the answer before last arrives."""
    rng = np.random.default_rng(seed)
    clock, times, old = TickClock(), [], []
    for k in range(1000):
        host = 1000 + 0.07 * k + rng.uniform(0, 0.004)
        taken = host + rng.uniform(1e-4, 1e-3)
        device = start + (taken - 1000) * (1 + drift)
        counter = int(device * 1000) % 32768
        old.append(counter)
        late = k in stale
        found = clock.fresh(old[-2] if late else counter, host, taken + rng.uniform(1e-4, 2e-3))
        if late:
            assert found is None
        else:
            assert found is not None
            times.append((found, device))
    times = np.array(times)
    assert np.all(np.diff(times[:, 0]) > 0)
    assert np.ptp(times[:, 1] - times[:, 0]) < 1e-3 + 1e-9
    assert clock.stale + clock.repeated == len(set(stale))


# ---- between the processes


def test_the_longest_path_goes_over_in_pieces():
    """600 s at 500 Hz of six joints, to the driver of an arm that is not there."""
    rows = np.random.default_rng(0).uniform(-1, 1, (300_001, 6))
    driver = Driver("jaxid.hardware.ur.driver", "test")
    try:
        assert hand_over(driver, rows, 60.0) == int(np.ceil(len(rows) / 500))
        with pytest.raises(
            HardwareError, match="numbers of the path came for row"
        ):  # not asked for
            driver.ask("rows", "nothing", 10.0, at=7, content="AAAAAAAA8D8=")
    finally:
        driver.close()


@settings(max_examples=30, deadline=None)
@given(rows=st.integers(1, 9000), joints=st.integers(1, 7))
def test_a_table_arrives_as_it_was(rows, joints):
    table, taken = np.random.default_rng(rows).standard_normal((rows, joints)), PathTable()
    table[rows // 2, 0] = np.nan  # for the clamp to refuse, and nobody else
    sent: list[dict] = []
    sender = Sender(table, lambda kind, **content: sent.append({"kind": kind, **content}))
    while True:
        kind, content = taken.take(sent[-1])
        if kind == "loaded":
            break
        with pytest.raises(ValueError, match="of the path are there"):
            iter(taken)
        sender.answer(content)
        assert len(json.dumps(sent[-1])) < 40_000
    np.testing.assert_array_equal(np.array(list(taken)), table)


def test_words_wait_for_a_slow_listener_and_the_last_one_says_why():
    """Far more than a line holds, while nobody reads; then the sender ends."""
    here, there = socket.socketpair()
    driver, recorder = Link(here), Link(there)
    for k in range(20_000):
        driver.send("sample", number=k)
    farewell(driver, StopRequest("the reason"))
    ender = threading.Thread(target=lambda: (farewell(driver), driver.close()))
    ender.start()
    heard = []
    with pytest.raises(Closed):
        while True:
            heard += recorder.messages(1.0)
    ender.join()
    recorder.close()
    assert [m["number"] for m in heard[:-2]] == list(range(20_000))
    assert heard[-2:] == [{"kind": "stopping", "reason": "the reason"}, {"kind": "stopped"}]


def test_a_reason_is_heard_although_the_line_is_closed():
    """The driver ends while the recorder writes to it; what it said before its end is raised, not
    that the line is gone.
    """
    driver = Driver("jaxid.hardware.ur.driver", "test")
    driver.send("quit")
    driver.process.wait(20)
    for _ in range(3):
        driver.send("beat")
    with pytest.raises(HardwareError, match="test: the driver stopped by itself: finished"):
        driver.messages()
    driver.close()


@pytest.mark.parametrize("held", [False, True])
def test_a_silence_is_of_the_recorder_or_of_this_computer(held):
    here, there = socket.socketpair()
    leash = Leash(Link(here), 0.05)
    leash.tighten(True)
    leash.wait(time.monotonic())
    if held:
        time.sleep(0.3)  # this process is not run: the other one is not to blame
    with pytest.raises(
        StopRequest,
        match="this computer was busy for 0.[3-9] s"
        if held
        else "recording process was silent for 0.[01]",
    ):
        leash.wait(time.monotonic() + 1.0)
    here.close()
    there.close()


def test_a_pause_and_what_it_was():
    pauses = Pauses()
    pauses.lap()
    assert pauses.said(0.5) == ""
    time.sleep(0.12)
    pauses.lap(0.01)
    assert "this computer was busy for 0.1" in pauses.said(0.1) and pauses.said(1.0) == ""
    time.sleep(0.2)
    pauses.lap(doing="showing the progress")
    assert pauses.said(0.1).startswith("showing the progress took 0.2")
    assert waited(os.getpid()) >= 0.0 == waited(2**30)
    assert kept_from_running(
        0.5, 0.4
    ) == ": this computer was busy for 0.4 s" and "too busy" in kept_from_running(0.5, 0.1)


def test_a_port_has_one_reader(tmp_path):
    master, slave = os.openpty()
    name = os.ttyname(slave)
    line = opened(name, 57600)
    os.write(master, b"for the first")
    time.sleep(0.05)
    with pytest.raises(
        UsageError, match=f"port {name} is in use by another program.*wait until that has ended"
    ):
        opened(name, 115200)
    (tmp_path / "tip.toml").write_text(SENSOR.format(port=name))
    with pytest.raises(UsageError, match="sensor tip: port .* is in use"):
        SerialSensor(SensorSpec.read(tmp_path / "tip.toml")).open()
    assert line.read(100) == b"for the first" and line.baudrate == 57600
    line.close()
    opened(name, 115200).close()
    for wrong in (str(tmp_path), "/dev/null", "/dev/nowhere"):
        with pytest.raises(UsageError, match="cannot be opened .*check cable, name and rights"):
            opened(wrong, 57600)
    os.close(slave)
    os.close(master)


def test_a_recording_that_finds_no_room_is_refused(tmp_path):
    with pytest.raises(UsageError, match="1e.* s need .* GB, and .* GB are free for .*: make room"):
        refuse_size(tmp_path / "new" / "out", [STREAM], 1e12)
    refuse_size(tmp_path / "new" / "out", [STREAM], 1.0)


# ---- rows on disk

STREAM = Stream(
    "thing", (Column("q", "rad", "output", 1e-3), Column("current", "A", "input")), "its own", 0.01
)


def write(folder: Path, rows: int, close: bool = True) -> Recorder:
    recorder = Recorder(
        folder, [STREAM], {"name": "x", "description": "d", "source": {"hardware": "h"}}
    )
    for k in range(rows):
        recorder.append(0, 50 + 0.01 * k, 0.01 * k, (np.sin(0.1 * k), np.cos(0.1 * k)))
    if close:
        recorder.event("end", "the time was over", complete=True)
        recorder.close()
    return recorder


def test_rows_reach_the_disk_within_a_second(tmp_path):
    recorder = write(tmp_path / "run_1.recording", 100, close=False)
    time.sleep(1.0)
    assert len(read_rows(recorder.folder, STREAM).device) == 100
    recorder.close()


@settings(max_examples=30, deadline=None)
@given(cut=st.integers(0, 39), flips=st.lists(st.integers(0, 3999), max_size=3))
def test_torn_and_damaged_rows_are_left_out(tmp_path_factory, cut, flips):
    folder = tmp_path_factory.mktemp("rows") / "run_1.recording"
    write(folder, 100)
    file = folder / "thing.rows"
    content = bytearray(file.read_bytes())
    size = len(content) // 100
    for place in flips:
        content[place % len(content)] ^= 0x10
    file.write_bytes(
        bytes(content[: len(content) - cut % size]) + b"\0" * (size if cut == 7 else 0)
    )
    rows = read_rows(folder, STREAM)
    good = np.flatnonzero(np.isin(np.round(rows.device / 0.01), np.arange(100)))
    assert len(good) == len(rows.device) >= 99 - len(flips)
    np.testing.assert_allclose(rows.values[:, 0], np.sin(10 * rows.device), atol=1e-9)


def test_a_crash_is_recovered_with_its_reason(tmp_path):
    recorder = write(tmp_path / "out" / "run_1.recording", 300, close=False)
    recorder.event("note", "a thing happened")
    time.sleep(0.8)
    os.write(recorder._events.fileno(), b'{"host": 1, "ki')  # torn
    assert [e["kind"] for e in read_events(recorder.folder)] == ["note"]
    (result,) = recover(tmp_path / "out")
    assert (result.rows, result.complete, result.lost) == (
        300,
        False,
        0,
    ) and "a thing happened" in result.notes
    data = load_dataset(tmp_path / "out", check_model=False)
    np.testing.assert_array_equal(data.experiments[0].y[:, 0], np.sin(0.1 * np.arange(300)))
    recorder.close()


def test_a_full_disk_is_told(tmp_path):
    recorder = write(tmp_path / "run_1.recording", 10, close=False)
    recorder._files[0].close()
    recorder._files[0] = open("/dev/full", "ab", buffering=0)
    with pytest.raises(OSError, match="No space left"):
        for _ in range(60):
            recorder.append(0, 1.0, 1.0, (0.0, 0.0))
            time.sleep(0.05)
    with pytest.raises(OSError, match="No space left"):
        recorder.close()


def test_gaps_and_repeats_are_reported_and_nothing_is_invented(tmp_path):
    folder = tmp_path / "out" / "run_1.recording"
    recorder = Recorder(
        folder, [STREAM], {"name": "x", "description": "d", "source": {"hardware": "h"}}
    )
    for k in [*range(100), 99, 99, *range(110, 200), *range(230, 400)]:
        recorder.append(0, 50 + 0.01 * k, 0.01 * k, (np.sin(0.1 * k), np.cos(0.1 * k)))
    recorder.event("end", "over", complete=True)
    recorder.close()
    (result,) = recover(tmp_path / "out")
    assert (result.lost, result.duplicated, result.rows) == (10 + 30, 2, 360)
    assert result.gaps == ((0.99, 1.1, 10), (1.99, 2.3, 30))
    data = load_dataset(tmp_path / "out", check_model=False)
    assert len(data.experiments) == 2, "a gap over 20 steps splits the run"


# ---- channels


def test_channels_for_models():
    columns = [
        Column(f"{n}{j}", u, r)
        for n, u, r in [("q", "rad", "output"), ("current", "A", "input")]
        for j in (1, 2)
    ]
    plain = channel_map(None, columns, None, None)
    assert plain["q1"] == {"role": "output", "unit": "rad"} and plain["current2"]["role"] == "input"
    one = channel_map("pendulum", columns, 2, [5.0, 7.0])
    assert one["tau"] == {"role": "input", "unit": "N m", "column": "current2", "scale": 7.0}
    assert (
        one["q"]["column"] == "q2"
        and one["q1"]["role"] == one["current1"]["role"] == "auxiliary"
        and "q2" not in one
    )
    both = channel_map("planar_arm", columns, None, [5.0, 7.0])
    assert both["tau2"]["scale"] == 7.0 and both["q1"]["role"] == "output"
    for arguments, words in [
        (("pendulum", columns, None, [5.0]), "pick one with --joint"),
        (("pendulum", columns, 1, None), "State the gain"),
        (("nonsense", columns, 1, None), "no model 'nonsense'"),
    ]:
        with pytest.raises(UsageError, match=words):
            channel_map(*arguments)


def test_a_plan_of_torques_says_how_to_get_its_currents(tmp_path):
    plan = tmp_path / "plan.csv"
    plan.write_text("t,tau,q\n0,0,0\n1,1,0\n")
    with pytest.raises(UsageError, match="no column 'current_cmd'.*--gain .N m/A., which adds"):
        Trajectory.read(plan, 1, "current")
    with pytest.raises(UsageError, match="a velocity command needs one column$"):
        Trajectory.read(plan, 1, "velocity")


TWO_JOINTS = """<mujoco><worldbody>
  <body name="a"><joint name="shoulder" axis="0 1 0"/><geom size="0.1" mass="1"/>
    <body name="b" pos="0 0 1"><joint name="lift" type="{second}" axis="0 1 0"/><geom size="0.1" mass="1"/></body>
  </body></worldbody></mujoco>"""


def test_channels_for_a_robot_of_a_file(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(TWO_JOINTS.format(second="hinge"))
    kinds = [("q", "rad", "output"), ("current", "A", "input"), ("q_cmd", "rad", "auxiliary")]
    columns = [
        Column(name.replace("_", f"{j}_") if "_" in name else f"{name}{j}", unit, role)
        for name, unit, role in kinds
        for j in (1, 2)
    ]
    goals = channel_map(str(file), columns, None, None)
    assert goals["shoulder"] == {"role": "output", "unit": "rad", "column": "q1"}
    assert goals["lift_cmd"] == {"role": "input", "unit": "rad", "column": "q2_cmd"}
    assert goals["current1"]["role"] == "auxiliary" and "q2" not in goals
    torques = channel_map(str(file), columns, None, [5.0, 7.0])
    assert torques["lift_tau"] == {"role": "input", "unit": "N m", "column": "current2", "scale": 7}
    assert torques["q1_cmd"]["role"] == "auxiliary"
    file.write_text(TWO_JOINTS.format(second="slide"))
    with pytest.raises(
        UsageError, match="for 'lift' it needs 'q2' in m, which this device does not record"
    ):
        channel_map(str(file), columns, None, [5.0, 7.0])


def test_progress_of_a_recording_is_in_seconds_and_never_beyond_its_end():
    assert progress_said(2.9, 20.6, 500) == ("recording, seconds", 2, 20, "500 samples")
    late = progress_said(28.9, 20.6, 500)
    assert late[1:] == (20, 20, "500 samples, 8 s behind its plan")


# ---- sensors

SENSOR = """
name = "tip"
port = "{port}"
columns = ["ms", "ax"]
time = {{ column = "ms", unit = "ms", wraps_at = 1000 }}
[channels.tip_acceleration]
column = "ax"
unit = "g_n"
role = "output"
"""


def test_lines_of_a_serial_sensor(tmp_path):
    master, slave = os.openpty()
    tty.setraw(slave)
    (tmp_path / "tip.toml").write_text(SENSOR.format(port=os.ttyname(slave)))
    sensor = SerialSensor(SensorSpec.read(tmp_path / "tip.toml"))
    sensor.open()
    os.write(master, b"12\n980,0.5\n990,nonsense\n995,1.0,7\n999,nan\n4,1.0\n14,-1.0\n")
    time.sleep(0.05)
    samples = sensor.read()
    assert [round(s.device, 6) for s in samples] == [0.98, 1.004, 1.014] and sensor.malformed == 3
    assert [s.values[0] for s in samples] == pytest.approx([0.5 * 9.80665, 9.80665, -9.80665])
    os.close(slave)
    os.close(master)
    with pytest.raises(HardwareError, match="port .* is gone"):
        for _ in range(3):
            sensor.read()
    sensor.close()


def test_a_sensor_and_a_file_join_the_main_clock(tmp_path):
    """Main device at 100 Hz, a sensor at 333 Hz with a clock of its own, and a file from another
    logger.
    """
    rng = np.random.default_rng(3)

    def motion(t):
        return np.sin(2 * np.pi * 0.5 * t) + 0.4 * np.sin(2 * np.pi * 1.3 * t + 1)

    tip = Stream("tip", (Column("tip", "rad"),), "sensor time, column 'ms'")
    true = np.arange(0, 12, 0.004) + 0.5
    np.savetxt(
        tmp_path / "log.csv",
        np.column_stack(
            [(true - 30) * 1000, 3 * motion(true) + 0.01 * rng.standard_normal(len(true))]
        ),
        delimiter=",",
        header="ms,x",
        comments="",
    )
    spec = SensorSpec.model_validate(
        {
            "name": "other",
            "file": str(tmp_path / "log.csv"),
            "time": {"column": "ms", "unit": "ms"},
            "match": {"column": "x", "to": "q"},
            "channels": {"x": {"column": "x", "unit": "rad"}},
        }
    )
    folder = tmp_path / "out" / "run_1.recording"
    about = {
        "name": "x",
        "description": "d",
        "source": {"hardware": "h"},
        "sensor_files": [spec.model_dump(exclude_none=True)],
    }
    recorder = Recorder(folder, [STREAM, tip], about)
    for t in np.arange(0, 14, 0.01):
        recorder.append(0, 1000 + t + rng.exponential(5e-4), t, (motion(t), 0.1 * np.cos(t)))
    for t in np.arange(0.2, 13.8, 0.003):
        recorder.append(1, 1000 + t + rng.exponential(5e-4), 77 + t * (1 - 1e-4), (motion(t),))
    recorder.event("end", "over", complete=True)
    recorder.close()
    (result,) = recover(tmp_path / "out")
    rows = pq.read_table(tmp_path / "out" / result.file)
    q, tip_, x = (rows[n].to_numpy() for n in ("q", "tip", "x"))
    speed = 2 * np.pi * (0.5 + 0.4 * 1.3)
    assert (
        np.abs(q - tip_).max() < 2e-3 * speed
        and np.abs(3 * q - x).max() < 3 * (2e-3 * speed) + 0.05
    )
    about = json.loads((tmp_path / "out" / "run_1.json").read_text())
    assert "drift" in about["clocks"]["tip"] and "correlation" in about["clocks"]["other"]
    assert len(pq.read_table(tmp_path / "out" / "run_1.tip.parquet")) == len(
        np.arange(0.2, 13.8, 0.003)
    )
    assert any("rows without every sensor were left out" in n for n in result.notes)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s.replace('unit = "g_n"', 'unit = "parsec"'), "unknown unit 'parsec'"),
        (lambda s: s.replace('column = "ax"', 'column = "ay"'), "'ay' is not among `columns`"),
        (lambda s: s.replace("port", "prot"), "prot"),
        (lambda s: s.replace('port = "/dev/x"', 'file = "x.csv"'), "needs `time` and `match`"),
    ],
)
def test_a_wrong_description_of_a_sensor(tmp_path, change, words):
    (tmp_path / "tip.toml").write_text(change(SENSOR.format(port="/dev/x")))
    with pytest.raises(UsageError, match=words):
        SensorSpec.read(tmp_path / "tip.toml")


# ---- RTDE packets


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=200), st.integers(1, 7))
def test_any_bytes_are_rows_or_one_sentence(noise, cuts):
    """A reader that was set up, fed with good rows and then with anything in pieces of any size."""
    import socket

    here, there = socket.socketpair()
    reader = RTDEReader.__new__(RTDEReader)
    here.setblocking(False)
    reader.socket, reader._buffer, reader._fault, reader.notes, reader.where = (
        here,
        bytearray(),
        None,
        [],
        "test",
    )
    reader._layout, reader.recipe = struct.Struct(">2d"), 1
    good = struct.pack(">HBB2d", 20, DATA, 1, 0.5, 0.25)
    content = good * 3 + noise
    rows, fault = [], None
    step = max(1, len(content) // cuts)
    for k in range(0, len(content), step):
        there.sendall(content[k : k + step])
        try:
            rows += reader.read()
        except HardwareError as error:
            fault = error
            break
    there.close()
    if fault is None:
        with pytest.raises(HardwareError) as caught:
            for _ in range(3):
                rows += reader.read()
        fault = caught.value
    assert [r[1] for r in rows[:3]] == [(0.5, 0.25)] * 3 and "\n" not in str(fault)
    here.close()


# ---- the command line


def test_commands_say_what_is_wrong(tmp_path, capsys):
    out = ["--out", str(tmp_path / "out")]
    for arguments, words in [
        (["record", "ur11"], "did you mean 'ur10'"),
        (["record", "ur10", "--host", "127.0.0.1", *out], "how many seconds"),
        (["record", "ur10", "--host", "127.250.250.250", "--seconds", "1", *out], "no connection"),
        (
            ["record", "dynamixel", "--port", "/dev/null", "--id", "1", "--play", "x", *out],
            "say with --mode",
        ),
        (
            [
                "record",
                "dynamixel",
                "--port",
                "/dev/null",
                "--id",
                "1",
                "--zero",
                "up",
                "--seconds",
                "1",
                *out,
            ],
            "number of counts",
        ),
        (["record", "recover", str(tmp_path)], "no unfinished recording"),
        (
            ["record", "ur10", "--host", "x", "--seconds", "1", "--gain", "a,b", *out],
            "not a number",
        ),
        (["emulate", "ur10", "--host", "192.168.1.1"], "loopback only"),
        (["emulate", "dynamixel", "--plant", str(tmp_path / "no.toml")], "cannot be read"),
        (["emulate", "dynamixel", "--baud", "1234"], "no baud rate 1234"),
    ]:
        assert main(arguments) == 2, arguments
        errors = capsys.readouterr().err
        assert words in errors and "Traceback" not in errors, errors
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('model = "planar_arm"', "one driven revolute joint"),
        ('model = "pendulum"\n[parameters]\ninertai = 1', "no parameter 'inertai'"),
        (
            '[[effects]]\neffect = "input_delay"\nparameters = { delay = 0.01 }',
            "history of the command",
        ),
        ('[[effects]]\neffect = "dead_zone"\nparameters = { widht = 0.1 }', "no parameter 'widht'"),
        ('[[effects]]\neffect = "dead_zone"\njoint = 9', "joint is 9"),
        ("[parameters]\ninertia = [1, 2]", "2 values for 1 joints"),
        ("[parameters]\ninertia = nan", "inertia is nan"),
    ],
)
def test_a_wrong_plant_is_refused(tmp_path, capsys, text, words):
    (tmp_path / "plant.toml").write_text(text)
    assert main(["emulate", "dynamixel", "--plant", str(tmp_path / "plant.toml")]) == 2
    assert words in capsys.readouterr().err


def test_plants_are_models_in_real_time():
    """A joint alone against its equation in plain Python; a whole arm against its own
    acceleration.
    """
    from jaxid.hardware.emulators.plant import Ideal, Modelled

    numbers = {"inertia": 0.03, "viscous": 0.06, "gravity_torque": 0.8}
    plain = Ideal([0.03], [0.06], [0.8])
    model = Modelled("pendulum", [numbers | {"coulomb": 0.0, "offset": 0.0}], [])
    reached = 0.0
    for k in range(200):
        for plant in (plain, model):
            plant.advance(0.005, [0.3 * np.sin(0.03 * k)])
        assert model.q == pytest.approx(plain.q, abs=2e-3)
        reached = max(reached, abs(model.q[0]))
    assert reached > 0.1

    from jaxid.models import UR10

    torque = np.array([5.0, -60.0, -30.0, -4.0, 2.0, 1.0])
    free = [{"F_c": 0.0, "F_v": 0.0, "offset": 0.0}] * 6
    with float64():
        rest = jnp.zeros(6)
        qdd = np.asarray(UR10().vector_field(0.0, (rest, rest), jnp.asarray(torque))[1])
    plants = {
        "bare": Modelled("ur10", free, []),
        "loaded": Modelled("ur10", [{**free[0], "payload": 2.0}, *free[1:]], []),
        "stuck": Modelled("ur10", [*free[:5], {**free[5], "F_c": 100.0}], []),
    }
    for plant in plants.values():
        plant.advance(1e-4, torque.tolist())
    speed = {name: np.array(plant.qd) for name, plant in plants.items()}
    assert np.allclose(speed["bare"] / 1e-4, qdd, rtol=1e-3, atol=1e-3)
    assert np.abs(speed["loaded"] - speed["bare"]).max() > 1e-5  # all joints feel the load
    assert speed["stuck"][5] == 0 != speed["stuck"][4]  # F_c of joint 6 alone
    with pytest.raises(UsageError, match="3"):
        Modelled("ur10", free[:3], [])
