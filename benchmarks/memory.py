"""Memory and time of long recordings: `check`, `fit` and `diagnose` of a pendulum, `identify` of an
arm with seven joints.

Each row is a process of its own that runs the command on recordings at 1 kHz; memory is the most
that was resident at a time. `before` is the code of a revision that is given (`--before FOLDER`: a
checkout of it), whose figures are kept from run to run.
"""

from __future__ import annotations

import argparse
import datetime
import json
import math
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np


HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

RATE = 1000.0
ROWS = (10_000, 100_000, 1_000_000, 3_600_000)
#: Effects that the diagnosis chooses among: with all of them the largest recordings take hours.
FEW = "dead_zone,input_delay"
COMMANDS = {"check": (), "fit": (), "identify": (), "diagnose": ("--effects", FEW)}
#: What does not end within so many seconds of processor time is ended, and said.
LONGEST = 1800


def pendulum(rows: int) -> dict[str, np.ndarray]:
    """One run from rest with dry friction, by semi-implicit steps."""
    rng = np.random.default_rng(0)
    t = np.arange(rows) / RATE
    u = np.zeros(rows)
    for f, p in zip(rng.uniform(0.1, 2.5, 6), rng.uniform(0, 6.28, 6), strict=True):
        u += 0.25 * np.sin(2 * np.pi * f * t + p)
    angle = speed = 0.0
    q = np.empty(rows)
    for k, torque in enumerate(u.tolist()):
        q[k] = angle
        speed += (
            (torque - 1.4 * math.sin(angle) - 0.05 * speed - 0.1 * math.tanh(speed / 0.01))
            / 0.06
            / RATE
        )
        angle += speed / RATE
    return {"t": t, "tau": u, "q": q + 2e-4 * rng.standard_normal(rows)}


def arm(rows: int, seed: int) -> dict[str, np.ndarray]:
    """Motion of seven joints and torques that look like theirs."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows) / RATE
    out = {"t": t}
    for j in range(7):
        a, p, w = (
            rng.uniform(0.02, 0.15, 5),
            rng.uniform(0, 6.28, 5),
            2 * np.pi * 0.1 * np.arange(1, 6),
        )
        q, v = np.zeros(rows), np.zeros(rows)
        for size, speed, phase in zip(a, w, p, strict=True):
            q += size * np.sin(speed * t + phase)
            v += size * speed * np.cos(speed * t + phase)
        out[f"q{j + 1}"] = q - 1.5 * (j == 3) + 1e-5 * rng.standard_normal(rows)
        out[f"tau{j + 1}"] = (
            5 * np.sin(q) + 2 * np.tanh(v / 0.01) + v + 0.05 * rng.standard_normal(rows)
        )
    return out


def write(folder: Path, command: str, rows: int) -> None:
    """A dataset of so many rows."""
    import pyarrow
    import pyarrow.parquet

    folder.mkdir(parents=True)

    def put(name, columns):
        return pyarrow.parquet.write_table(pyarrow.table(columns), folder / f"{name}.parquet")

    def entry(name, more):
        return f'[[experiments]]\nfile = "{name}.parquet"\n{more}\n'

    head = 'name = "long"\ndescription = "made by benchmarks/memory.py"\n[model]\nname = "{}"\n'

    def channel(name, role, unit, more=""):
        return f'[channels.{name}]\nrole = "{role}"\nunit = "{unit}"\n{more}'

    if command == "identify":
        put("fit", arm(rows, 0))
        put("validation", arm(max(2000, rows // 10), 1))
        text = head.format("panda") + "".join(
            channel(f"tau{j}", "input", "N m") + channel(f"q{j}", "output", "rad")
            for j in range(1, 8)
        )
        text += entry("fit", 'split = "fit"') + entry("validation", 'split = "validation"')
    else:
        put("fit", pendulum(rows))
        text = (
            head.format("pendulum")
            + channel("tau", "input", "N m")
            + channel("q", "output", "rad", "noise_std = 2e-4\n")
        )
        text += entry("fit", 'split = "fit"\nat_rest = true')
    (folder / "dataset.toml").write_text(text)


def measured(command: str, folder: Path, code: Path) -> dict[str, Any]:
    """Peak of the resident memory, wall and CPU time of one command in a process of its own."""
    program = f"import sys; sys.path.insert(0, {str(code)!r}); import jaxid.cli.app; sys.exit(jaxid.cli.app.main(sys.argv[1:]))"
    with tempfile.TemporaryDirectory() as out, open(f"{out}/said", "w+") as said:
        words = [command, str(folder), "--out", f"{out}/o", "--quiet", *COMMANDS[command]]
        began = time.perf_counter()

        def limited():
            return resource.setrlimit(resource.RLIMIT_CPU, (LONGEST, LONGEST))

        child = subprocess.Popen(
            [sys.executable, "-c", program, *words], stderr=said, preexec_fn=limited
        )
        _, status, used = os.wait4(child.pid, 0)
        child.returncode, wall = os.waitstatus_to_exitcode(status), time.perf_counter() - began
        said.seek(0)
        words = said.read().strip().splitlines()
    ended = (
        "well"
        if child.returncode == 0
        else f"not within {LONGEST} s"
        if child.returncode == -signal.SIGKILL
        else ""
    )
    ended = ended or f"exit {child.returncode}: {words[-1][:80] if words else ''}"
    scale = 1 if sys.platform == "darwin" else 1024
    return {
        "GB": used.ru_maxrss * scale / 1e9,
        "wall s": wall,
        "CPU s": used.ru_utime + used.ru_stime,
        "ended": ended,
    }


def cell(found: dict[str, Any] | None, key: str) -> str:
    if found is None:
        return "not run"
    return f"{found[key]:.2f}" if key == "GB" else f"{found[key]:.0f}"


def main(
    before: Path | None = None,
    commands: tuple[str, ...] = tuple(COMMANDS),
    rows: tuple[int, ...] = ROWS,
) -> dict[str, Any]:
    kept = HERE / "results" / "memory.json"
    figures: dict[str, Any] = json.loads(kept.read_text())["figures"] if kept.is_file() else {}
    with tempfile.TemporaryDirectory() as place:
        for count in rows:
            for command in commands:
                folder = Path(place) / f"{command}_{count}"
                write(folder, command, count)
                for label, code in (("before", before), ("after", HERE.parent)):
                    if code is not None:
                        figures[f"{command} {count} {label}"] = found = measured(
                            command, folder, code
                        )
                        print(command, count, label, found, flush=True)
    table = []
    for command in COMMANDS:
        for count in ROWS:
            old, new = (figures.get(f"{command} {count} {label}") for label in ("before", "after"))
            if new or old:
                row = {"command": command, "rows": f"{count:,}"}
                for label, found in (("before", old), ("after", new)):
                    row |= {
                        f"GB {label}": cell(found, "GB"),
                        f"CPU s {label}": cell(found, "CPU s"),
                    }
                    row |= {f"ended {label}": found["ended"] if found else ""}
                table.append(row)
    text = (
        " ".join((__doc__ or "").split())
        + f" The diagnosis chooses among {FEW.replace(',', ' and ')}."
    )
    return {
        "title": "Memory and time of long recordings",
        "text": text,
        "rows": table,
        "figures": figures,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--before", type=Path)
    parser.add_argument("--commands", nargs="*", default=list(COMMANDS), choices=list(COMMANDS))
    parser.add_argument("--rows", nargs="*", type=int, default=list(ROWS))
    a = parser.parse_args()
    result = main(a.before, tuple(a.commands), tuple(a.rows))
    import run_all

    result |= {"date": datetime.date.today().isoformat(), "machine": run_all.machine()}
    (HERE / "results" / "memory.json").write_text(json.dumps(result, indent=1) + "\n")
