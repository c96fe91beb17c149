"""Long paths on emulators: what plays to its end, what ends early and why, and two recorders on one
port.

Each run is the real client library (ur_rtde, ROBOTIS' SDK) against an emulator in a process of its
own, in real time: five paths of 120 s and one of 600 s for the arm (500 rows and 500 samples a
second, six joints), one of 400 s for the servo (200 a second). `data_age` is 2 s, the most there
is, as these emulators share their processors with whatever else this computer does. A witness that
wants to run every 5 ms says for how long it was not let: it tells a computer that stands still from
a fault of ours, though not one that is only short of processors, for it needs next to none; that is
the load.

    python benchmarks/long_paths.py [NAME ...]     # of arm-120-1 … arm-120-5, arm-600, servo-400, two-recorders; others are kept
"""

from __future__ import annotations

import datetime
import json
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np


sys.path[:0] = [
    str(Path(__file__).resolve().parents[1]),
    str(Path(__file__).resolve().parents[1] / "tests"),
]

from emulators import Emulator  # noqa: E402
from jaxid.hardware import Trajectory  # noqa: E402


KEPT = Path(__file__).with_name("results") / "long_paths.json"
RATE = {"arm": 500.0, "servo": 200.0}


class Witness:
    """A thread that sleeps 5 ms at a time; `longest_s` is the most that it overslept, `over` how
    often by more than 0.1 s.
    """

    def __init__(self):
        self.longest_s, self.over, self._going = 0.0, 0, True
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        while self._going:
            began = time.monotonic()
            time.sleep(0.005)
            late = time.monotonic() - began - 0.005
            self.longest_s, self.over = max(self.longest_s, late), self.over + (late > 0.1)

    def end(self) -> None:
        self._going = False
        self._thread.join()


def end_of(errors: str, folder: Path) -> str:
    """What a command said last, without the folders and ports of this computer."""
    last = (errors.strip().splitlines() or ["nothing was said"])[-1]
    return re.sub(r"/dev/\S+?(?=[:\s]|$)", "the port", last.replace(f"{folder}/", "")).removeprefix(
        "jaxid: "
    )


def waited_share() -> float:
    """Share of the last five minutes (0 to 1) in which some process of this computer waited for a
    processor; nan if not told.
    """
    try:
        some = Path("/proc/pressure/cpu").read_text().split("\n")[0]
        return float(dict(f.split("=") for f in some.split()[1:])["avg300"]) / 100
    except (OSError, KeyError, ValueError):
        return float("nan")


def record(device: str, emulator: Emulator, out: Path, *more: str) -> subprocess.Popen:
    """`jaxid record` as a user types it."""
    where = ["ur10", "--host"] if device == "arm" else ["dynamixel", "--id", "1", "--port"]
    command = [
        sys.executable,
        "-m",
        "jaxid.cli",
        "record",
        *where,
        emulator.address,
        "--out",
        str(out),
        *more,
    ]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def path_file(device: str, seconds: float, folder: Path, seed: int) -> Path:
    joints, kind, stem = (6, "position", "q") if device == "arm" else (1, "current", "current")
    play = Trajectory.multisine(
        [0.3] * joints,
        seconds,
        frequencies=(0.1, 0.6),
        rest=0.5,
        kind=kind,
        seed=seed,
        rate=RATE[device],
    )
    names = ",".join(f"{stem}{j + 1 if joints > 1 else ''}_cmd" for j in range(joints))
    file = folder / "path.csv"
    np.savetxt(
        file,
        np.column_stack([play.t, play.values]),
        delimiter=",",
        header="t," + names,
        comments="",
        fmt="%.9g",
    )
    return file


def played(device: str, seconds: float, seed: int = 0) -> dict[str, object]:
    """One path from its file to the dataset."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        emulator = Emulator.ur(folder) if device == "arm" else Emulator.servo(folder)
        file = path_file(device, seconds, folder, seed)
        (folder / "limits.toml").write_text("data_age = 2.0\n")
        mode = [] if device == "arm" else ["--mode", "current"]
        witness = Witness()
        try:
            more = ["--play", str(file), "--live", "--limits", str(folder / "limits.toml"), *mode]
            process = record(device, emulator, folder / "out", *more)
            _, errors = process.communicate(timeout=2 * seconds + 120)
        finally:
            witness.end()
            emulator.close()
        halts = [e["why"] for e in emulator.log("halt")]
        report = (
            json.loads((folder / "out" / "run_1.json").read_text())
            if (folder / "out" / "run_1.json").is_file()
            else {}
        )
        marks = {e.get("name"): e["host"] for e in report.get("events", []) if e["kind"] == "mark"}
        took = marks["play_end"] - marks["play_start"] if "play_end" in marks else float("nan")
        return {
            "what": f"{'UR, six joints' if device == 'arm' else 'servo'}, {seconds:g} s at {RATE[device]:g} Hz",
            "rows of the path": round(seconds * RATE[device]) + 1,
            "played": "yes"
            if process.returncode == 0
            else f"no: {end_of(errors, folder)} [emulator: {', '.join(halts)}]",
            "path took (s)": round(took, 1),
            "rows": report.get("rows", 0),
            "lost": report.get("lost", 0),
            "computer's longest pause (s)": round(witness.longest_s, 3),
            "pauses over 0.1 s": witness.over,
            "load (share of time)": round(waited_share(), 2),
        }


def two_recorders() -> dict[str, object]:
    """A second recorder comes again and again to the port of the first, in 14 of its 20 s."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        emulator, witness = Emulator.servo(folder), Witness()
        try:
            first = record("servo", emulator, folder / "first", "--seconds", "20")
            emulator.wait_for(lambda log: any(e["what"] == "read" for e in log), 30.0)
            refused, until = [], time.monotonic() + 14.0
            while time.monotonic() < until:
                second = record("servo", emulator, folder / "second", "--seconds", "1")
                refused.append((second.communicate(timeout=60)[1].strip(), second.returncode))
            _, errors = first.communicate(timeout=60)
        finally:
            witness.end()
            emulator.close()
        report = json.loads((folder / "first" / "run_1.json").read_text())
        good = sum(code == 2 and "is in use" in text for text, code in refused)
        return {
            "what": f"two recorders on one port: {good} of {len(refused)} refused as in use, with exit 2",
            "played": "the first went on"
            if first.returncode == 0
            else f"no: {end_of(errors, folder)}",
            "rows": report["rows"],
            "lost": report["lost"],
            "lost answers": next((e["text"] for e in report["events"] if "losses" in e), "none"),
            "computer's longest pause (s)": round(witness.longest_s, 3),
            "pauses over 0.1 s": witness.over,
            "load (share of time)": round(waited_share(), 2),
        }


RUNS: dict[str, Callable[[], dict[str, object]]] = {
    **{f"arm-120-{k}": lambda k=k: played("arm", 120.0, k) for k in range(1, 6)},
    "arm-600": lambda: played("arm", 600.0),
    "servo-400": lambda: played("servo", 400.0),
    "two-recorders": two_recorders,
}


def main(names: tuple[str, ...] = ()) -> dict:
    """Everything, one after the other (26 minutes of real time, little of it at work), or those
    runs anew.
    """
    kept = json.loads(KEPT.read_text()).get("runs", {}) if KEPT.is_file() else {}
    for name in names or RUNS:
        kept[name] = RUNS[name]()
        print(json.dumps(kept[name], indent=1), flush=True)
    text = (__doc__ or "").split("\n    python")[0].strip()
    return {
        "title": "Long paths on emulated hardware",
        "text": text,
        "rows": [kept[n] for n in RUNS if n in kept],
        "runs": kept,
    }


if __name__ == "__main__":
    import run_all

    result = main(tuple(sys.argv[1:])) | {
        "date": datetime.date.today().isoformat(),
        "machine": run_all.machine(),
    }
    KEPT.write_text(json.dumps(result, indent=1) + "\n")
