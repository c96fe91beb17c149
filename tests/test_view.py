"""`jaxid view` and `jaxid watch`: who is answered, what is drawn, and what is known by when."""

from __future__ import annotations

import asyncio
import html
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import tomllib
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from pyarrow import parquet

import jaxid
from chromium import BROWSER, Chromium, DESKTOP, PHONE
from emulators import Emulator
from jaxid.hardware import Dynamixel, record
from jaxid.hardware.finishing import finish
from jaxid.hardware.recorder import Column, Recorder, Stream
from jaxid.view.recording import excitation, turns, watch_site, Watcher
from jaxid.view.server import Site


pytest.importorskip("bokeh")

BROWSED = pytest.mark.skipif(BROWSER is None, reason="no Chromium here: no page was looked at")
NUMBERS = {"inertia": 0.05, "gravity_torque": 1.0, "viscous": 0.05, "coulomb": 0.05, "offset": 0.01}


@contextmanager
def served(site: Site) -> Iterator[str]:
    """The site on a thread; its address."""
    ready, stop = threading.Event(), asyncio.Event()
    loop = asyncio.new_event_loop()

    def work() -> None:
        loop.run_until_complete(site.serve(0, lambda _: ready.set(), stop))

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    assert ready.wait(60)
    try:
        yield site.address
    finally:
        loop.call_soon_threadsafe(stop.set)
        thread.join(30)
        loop.close()


def status(url: str, **headers: str) -> int:
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers)) as answer:
            return answer.status
    except urllib.error.HTTPError as error:
        return error.code


def asked(site: Site, name: str, **parameters: str) -> Any:
    """What an address answers to who has the cookie."""
    url = f"http://127.0.0.1:{site.port}/{name}?{urllib.parse.urlencode(parameters)}"
    cookie = f"jaxid{site.port}={site.token}"
    with urllib.request.urlopen(urllib.request.Request(url, headers={"Cookie": cookie})) as answer:
        return json.loads(answer.read())


def browsed(address: str, folder: Path) -> str:
    """The page as a browser has built it."""
    assert BROWSER is not None
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"]
    command += [f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=30000", address]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=250, check=True)
    return html.unescape(shown.stdout)


def motion(seconds: float = 6.0) -> tuple[np.ndarray, np.ndarray]:
    t = np.arange(0.0, seconds, 0.01)
    return t, 0.9 * np.sin(3 * t) + 0.6 * np.sin(7.1 * t + 1)


def dataset(q: np.ndarray, t: np.ndarray, tau: np.ndarray) -> jaxid.Dataset:
    return jaxid.Dataset.from_arrays(
        t,
        {"tau": tau},
        {"q": q},
        units={"tau": "N m", "q": "rad"},
        noise_std={"q": 1e-4},
        model="pendulum",
        at_rest=True,
    )


def content(width: float | None) -> dict[str, Any]:
    """A result as its file holds it."""
    effects = []
    if width is not None:
        numbers = {"width": {"value": width}}
        effects = [{"effect": "dead_zone", "location": "tau", "parameters": numbers}]
    parameters = {name: {"value": value} for name, value in NUMBERS.items()}
    return {"kind": "fit", "model": "pendulum", "parameters": parameters, "effects": effects}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    """A folder with a recording of a pendulum with a dead zone, and two results."""
    folder = tmp_path_factory.mktemp("view")
    t, tau = motion()
    still = dataset(0.1 * t, t, tau)
    q = np.asarray(jaxid.simulate("pendulum", still, content(0.2)).runs[0]["q"])
    data = dataset(q + 1e-4 * np.random.default_rng(0).normal(size=t.size), t, tau)
    jaxid.save_dataset(data, folder / "data")
    saved = jaxid.load_dataset(folder / "data")
    of = {"dataset": saved.name, "dataset_sha256": saved.sha256}
    for name, width in (("with", 0.2), ("without", None)):
        (folder / name).mkdir()
        (folder / name / "fit.json").write_text(json.dumps({**content(width), **of}))
    return folder


@pytest.fixture(scope="module")
def site(recorded) -> Site:
    from jaxid.view.compare import results_site
    from jaxid.view.results import read_results, Viewer

    results = read_results([recorded / "with", recorded / "without"])
    return results_site(Viewer(results, jaxid.load_dataset(recorded / "data")))


def test_only_who_has_the_token_is_answered():
    site = Site("<p>page</p>", {}, {"told": lambda _: {"a": 1}})
    with served(site) as address:
        base = address.partition("?")[0]
        cookie = f"jaxid{site.port}={site.token}"
        assert status(base) == status(f"{base}?token=wrong") == status(f"{base}told") == 403
        assert status(address) == 200
        assert status(f"{base}told", Cookie=cookie) == 200
        assert status(f"{base}told", Cookie=f"jaxid{site.port}=wrong") == 403
        assert status(f"{base}told", Cookie=cookie, Host="attacker.example") == 403
        assert status(f"{base}../../etc/passwd", Cookie=cookie) == 404
        assert status(f"{base}told?token={site.token}") == 403, "the token opens the page alone"


def test_nothing_listens_beyond_the_loopback():
    before = {c.laddr for c in psutil.Process().net_connections() if c.status == "LISTEN"}
    with served(Site("", {}, {})):
        after = {c.laddr for c in psutil.Process().net_connections() if c.status == "LISTEN"}
        assert {address.ip for address in after - before} == {"127.0.0.1"}


def test_a_switched_off_effect_changes_its_own_free_run_alone(site):
    with served(site):
        about = asked(site, "about")
        on = asked(site, "series", run="0", off="[[], []]")
        off = asked(site, "series", run="0", off='[["dead_zone at tau"], []]')
        refused = asked(site, "series", run="7", off="[[], []]")
    assert [r["effects"] for r in about["results"]] == [["dead_zone at tau"], []]
    assert on["rms"]["q"][0] < 3e-4 < 0.01 < on["rms"]["q"][1]
    assert off["rms"]["q"][0] == off["rms"]["q"][1] == on["rms"]["q"][1]
    assert off["simulated"]["q"][0]["y"] != on["simulated"]["q"][0]["y"]
    assert "no such run" in refused["error"]


#: Start and end of the time axis of every picture, and where the first one's frame lies.
RANGES = """
Bokeh.documents.flatMap(d => [...d._all_models.values()])
  .filter(m => m.type === "Figure").map(f => [f.x_range.start, f.x_range.end])
"""
FRAME = """
(() => {
  const view = Bokeh.index.get_by_id ? [...Bokeh.index][0] : Object.values(Bokeh.index)[0];
  const plot = view.child_views.find(v => v.frame || (v.child_views || []).length);
  const own = plot.frame ? plot : plot.child_views[0];
  const at = own.el.getBoundingClientRect(), box = own.frame.bbox;
  return [at.x + box.left, at.y + box.top, box.width, box.height];
})()
"""


@BROWSED
@pytest.mark.timeout(600)
def test_zoom_goes_together_and_a_switch_draws_anew(site, tmp_path):
    """By the mouse: a box drawn in the first picture, an effect switched off."""
    with served(site) as address, Chromium(tmp_path) as browser:
        browser.open(address)
        browser.wait("document.getElementById('said').textContent.startsWith('rms error')")
        before = browser.evaluate(RANGES)
        assert len(before) == 2 and before[0] == before[1]
        left, top, width, height = browser.settled(FRAME)
        start = (left + 0.3 * width, top + 0.2 * height)
        end = (left + 0.6 * width, top + 0.8 * height)
        browser.drag(start, end)
        first, second = browser.wait(f"(r => r[0][0] > {before[0][0]} ? r : null)({RANGES})")
        assert first == second
        whole = before[0][1] - before[0][0]
        assert first[0] == pytest.approx(before[0][0] + 0.3 * whole, abs=0.05 * whole)
        assert first[1] == pytest.approx(before[0][0] + 0.6 * whole, abs=0.05 * whole)
        told = browser.evaluate("document.getElementById('said').textContent")
        browser.click("input[type=checkbox]")
        script = "document.getElementById('said').textContent"
        browser.wait(f"(t => t.startsWith('rms') && t !== {json.dumps(told)})({script})")
        assert browser.evaluate(RANGES)[0] == first, "a switch keeps the zoom"


@BROWSED
@pytest.mark.timeout(600)
@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_the_pages_are_accessible(site, recorded, size, tmp_path):
    watcher = Watcher(recorded / "data")
    watcher.begin()
    try:
        with Chromium(tmp_path, size) as browser:
            with served(site) as address:
                browser.open(address)
                browser.wait("document.getElementById('said').textContent.startsWith('rms error')")
                beside = browser.violations()
            with served(watch_site(watcher)) as address:
                browser.open(address)
                browser.wait("document.querySelectorAll('#told table').length === 2")
                watched = browser.violations()
    finally:
        watcher.stop()
    assert beside == watched == []


@BROWSED
@pytest.mark.timeout(600)
def test_results_lie_over_each_other_in_a_browser(site, tmp_path):
    with served(site) as address:
        shown = browsed(address, tmp_path)
        switched = browsed(f"{address}&off=dead_zone%20at%20tau", tmp_path)
    assert "bk-GridPlot" in shown and "Content Security" not in shown
    errors = [
        re.findall(r"q: with (\S+) rad, without (\S+) rad", page) for page in (shown, switched)
    ]
    (good, bad), (same, other) = errors[0][0], errors[1][0]
    assert float(good) < 3e-4 < float(bad)
    assert same == other == bad


def heeding_interrupts() -> None:
    """In a process to be: tests that run in the background of a shell pass on that SIGINT is
    ignored.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "words",
    [["jaxid", "view", "with", "without"], ["jaxid", "watch", "data"]],
    ids=["view", "watch"],
)
def test_the_commands_open_their_page_and_end_by_ctrl_c(words, recorded, tmp_path):
    opener, told = tmp_path / "opener", tmp_path / "address"
    opener.write_text(f'#!/bin/sh\nprintf %s "$1" > {told}\n')
    opener.chmod(0o755)
    environment = {**os.environ, "BROWSER": f"{opener} %s"}
    served_by = subprocess.Popen(
        [sys.executable, "-m", *words],
        cwd=recorded,
        env=environment,
        stdout=subprocess.PIPE,
        preexec_fn=heeding_interrupts,
    )
    try:
        until = time.monotonic() + 240
        while not told.is_file() or not told.read_text():
            assert served_by.poll() is None and time.monotonic() < until
            time.sleep(0.2)
        assert status(told.read_text()) == 200
    finally:
        served_by.send_signal(signal.SIGINT)
        code = served_by.wait(60)
    assert code == 0


def test_a_folder_without_a_result_is_refused(tmp_path):
    from jaxid.view.results import read_results

    with pytest.raises(jaxid.UsageError, match="neither diagnosis.json nor fit.json"):
        read_results([tmp_path])
    (tmp_path / "fit.json").write_text("{}")
    with pytest.raises(jaxid.UsageError, match="not a result of jaxid"):
        read_results([tmp_path])


def test_the_recording_of_a_result_is_found_by_its_samples(recorded, tmp_path, monkeypatch):
    """Beside the result or below the folder one stands in; another of the same name is not it."""
    from jaxid.view.results import read_results, recording_of

    data = jaxid.load_dataset(recorded / "data")
    told = {**content(None), "dataset": data.name, "dataset_sha256": data.sha256}
    result = tmp_path / "results" / "own"
    result.mkdir(parents=True)
    (result / "fit.json").write_text(json.dumps(told))
    monkeypatch.chdir(tmp_path)
    saved = read_results([result])
    with pytest.raises(jaxid.UsageError, match="--dataset FOLDER"):
        recording_of([result], saved)
    t, tau = motion()
    jaxid.save_dataset(dataset(0.1 * t, t, tau), tmp_path / "data")
    with pytest.raises(jaxid.UsageError, match="neither here nor beside it"):
        recording_of([result], saved)
    shutil.copytree(recorded / "data", tmp_path / "kept" / "elsewhere")
    assert recording_of([result], saved).sha256 == data.sha256


# ---- a recording while it is made


def test_numbers_become_known_as_the_motion_goes_on(recorded, tmp_path):
    t, tau = motion()
    data = jaxid.load_dataset(recorded / "data")
    run = data.experiments[0]
    first = t < 2.0
    jaxid.save_dataset(dataset(run.y[first, 0], t[first], tau[first]), tmp_path / "short")
    early = Watcher(tmp_path / "short").look()
    assert "less than 3 s" in early["waiting"] and "numbers" not in early
    late = Watcher(recorded / "data").look()
    assert late["state"] == "the recording has ended"
    assert late["excitation"][0]["range"] > 0.5 and late["excitation"][0]["turns"] >= 2
    known = {row["name"]: row["known"] for row in late["numbers"]}
    assert known["inertia"] and known["gravity_torque"]
    assert late["enough"] == all(known.values())
    none = Watcher(recorded / "data", known=1e-6).look()
    assert not none["enough"]


@BROWSED
@pytest.mark.timeout(600)
def test_a_recording_that_has_ended_is_drawn_and_said_to_have_ended(recorded, tmp_path):
    watcher = Watcher(recorded / "data")
    assert watcher.rows() == {}, "nothing was looked at yet"
    watcher.look()
    assert [*watcher.rows()] == ["tau", "q"]
    watcher.begin()
    try:
        with served(watch_site(watcher)) as address, Chromium(tmp_path, DESKTOP) as browser:
            browser.open(address)
            browser.wait("document.querySelectorAll('#plots .bk-GridPlot').length === 1")
            said = "document.getElementById('said').textContent"
            browser.wait(f"{said}.startsWith('The recording has ended')")
    finally:
        watcher.stop()


def servo_rows(folder: Path, q: np.ndarray) -> None:
    """The rows of a servo that is only watched, as they lie on disk while it is recorded."""
    columns = (Column("q1", "rad", "output", 1.5e-3), Column("current1", "A", "input"))
    about = {"name": "x", "description": "d", "source": {"hardware": "h"}}
    stream = Stream("servo", columns, "its own", 0.01)
    recorder = Recorder(folder / "run_1.recording", [stream], about)
    for k, angle in enumerate(q):
        recorder.append(0, 50 + 0.01 * k, 0.01 * k, (float(angle), 0.0))
    recorder.close()


def test_a_servo_that_stands_still_is_waited_for(tmp_path):
    """It is no fault of the recording, and no line of a file that a person should change."""
    servo_rows(tmp_path, np.full(400, 0.3))
    found = Watcher(tmp_path).look()
    assert found["state"] == "recording"
    assert found["waiting"] == "q1 did not move so far: numbers are known from motion alone"
    finish(tmp_path / "run_1.recording")
    document = tomllib.loads((tmp_path / "dataset.toml").read_text())
    assert document["channels"]["q1"]["role"] == "output"
    ended = Watcher(tmp_path).look()
    assert ended["state"] == "the recording has ended"
    assert "output 'q1' never moves" in ended["waiting"]


def test_a_joint_that_stands_still_beside_one_that_moves_is_an_output(tmp_path):
    columns = (
        Column("q1", "rad", "output"),
        Column("q2", "rad", "output"),
        Column("current2", "A", "input"),
    )
    about = {"name": "x", "description": "d", "source": {"hardware": "h"}}
    stream = Stream("arm", columns, "its own", 0.01)
    recorder = Recorder(tmp_path / "run_1.recording", [stream], about)
    for k in range(400):
        recorder.append(0, 50 + 0.01 * k, 0.01 * k, (0.3, float(np.sin(0.03 * k)), 1.0))
    recorder.close()
    finish(tmp_path / "run_1.recording")
    data = jaxid.load_dataset(tmp_path, check_model=False)
    assert any("'q1' never moves" in note for note in data.notes)
    assert [c.name for c in data.outputs] == ["q1", "q2"]


def test_a_recording_that_has_not_begun_is_waited_for(tmp_path):
    """The page is there before anything moves, and the folder comes with the first rows."""
    for folder in (tmp_path / "run", tmp_path):
        found = Watcher(folder).look()
        assert found == {"state": f"waiting for a recording in {folder}"}


def test_what_is_there_is_said_before_the_numbers_are_found(recorded, monkeypatch):
    """The first fit compiles for longer than a short recording takes."""
    watcher, said = Watcher(recorded / "data"), []

    def fit(*_: Any, **__: Any) -> Any:
        said.append(watcher.told())
        raise jaxid.UsageError("not now")

    watcher._found = {"numbers": [], "state": "recording", "seconds": 1.0}
    monkeypatch.setattr(jaxid, "fit", fit)
    watcher.look()
    assert said[0]["seconds"] > 5 and said[0]["numbers"] == []
    assert said[0]["waiting"] == "numbers are looked for"


def test_turns_are_counted_beyond_the_noise():
    t = np.linspace(0, 10, 2001)
    wave = np.sin(2 * np.pi * t) + 0.01 * np.random.default_rng(0).normal(size=t.size)
    assert turns(wave) in (19, 20, 21)
    assert turns(np.zeros(5)) == 0
    assert excitation(dataset(wave, t, wave))[0]["unit"] == "rad"


@pytest.mark.realtime
@BROWSED
@pytest.mark.timeout(600)
def test_a_servo_is_watched_while_it_is_recorded(tmp_path):
    emulator = Emulator.servo(tmp_path)
    out = tmp_path / "out"
    watcher = Watcher(out)
    try:
        servo = Dynamixel(emulator.address, [1], rate=100.0)
        thread = threading.Thread(target=record, args=(servo, out), kwargs={"seconds": 20.0})
        thread.start()
        until = time.monotonic() + 15
        while not watcher.rows() and time.monotonic() < until:
            time.sleep(0.1)
        assert watcher.look()["state"] == "recording"
        channels = watcher.rows()
        with served(watch_site(watcher)) as address:
            watcher.begin()
            shown = browsed(address, tmp_path)
        thread.join(60)
    finally:
        watcher.stop()
        emulator.close()
    assert any(name.startswith("q") for name in channels)
    assert "bk-GridPlot" in shown
    assert (out / "dataset.toml").is_file(), "looking on does nothing to the recording"
    assert not list(out.glob("*.recording"))


@pytest.mark.realtime
@BROWSED
@pytest.mark.timeout(600)
def test_record_watch_opens_the_page_of_its_own_recording(tmp_path):
    """The command itself, end to end: the address that the browser would be sent to is opened, it
    stays when the recording has ended, and Ctrl-C leaves no process that serves.
    """
    emulator, out = Emulator.servo(tmp_path), tmp_path / "out"
    opener, told = tmp_path / "opener", tmp_path / "address"
    opener.write_text(f'#!/bin/sh\nprintf %s "$1" > {told}\n')
    opener.chmod(0o755)
    words = [sys.executable, "-m", "jaxid", "record", "dynamixel", "--port", emulator.address]
    words += ["--id", "1", "--rate", "100", "--seconds", "5", "--out", str(out), "--watch"]
    environment = {**os.environ, "BROWSER": f"{opener} %s"}
    recording = subprocess.Popen(
        words,
        env=environment,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=heeding_interrupts,
    )
    try:
        until = time.monotonic() + 240
        while not told.is_file() or not told.read_text():
            assert recording.poll() is None and time.monotonic() < until
            time.sleep(0.2)
        address = told.read_text()
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/\?token=\S+", address)
        with Chromium(tmp_path) as browser:
            browser.open(address)
            browser.wait("document.body.textContent.includes('Recording')")
            browser.wait("document.querySelector('.bk-GridPlot, [class*=GridPlot]') !== null")
            said = "document.getElementById('said').textContent"
            browser.wait(f"{said}.startsWith('The recording has ended')", 240)
            assert recording.poll() is None, "the page stays"
    finally:
        recording.send_signal(signal.SIGINT)
        recording.wait(60)
        emulator.close()
    assert recording.returncode == 0 and (out / "dataset.toml").is_file()
    assert parquet.read_metadata(out / "run_1.parquet").num_rows > 100
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(address)
