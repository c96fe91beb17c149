"""What a result in a folder survives: signals at random moments of a run that is to replace it, and
a full disk at every point.

Each run is the command itself, in a process forked from one that has imported JAX and computed
nothing. Of every sixteen signals one comes at a random moment of a whole run; the others meet the
command where it saves the numbers of an earlier run, without pictures, so that writing is what
takes the time: seven at a random moment of that, eight while files are being exchanged. So it does
where the disk is full. `JAXID_RELIABILITY=0.1` runs a tenth of the counts.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import pickle
import random
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

from jaxid import runtime
from jaxid.base.atomic_files import settle, STAGE
from jaxid.diagnosis.result import Diagnosis
from jaxid.report.result_files import result_of
from tests.test_batch import write_dataset


SHARE = float(os.environ.get("JAXID_RELIABILITY", "1"))
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL)
COMMANDS = {"fit": [], "diagnose": ["--effects", "dead_zone", "--max-effects", "1"]}
STEMS = {"fit": "fit", "diagnose": "diagnosis"}


def main() -> dict:
    runtime.prepare()
    import pyarrow.parquet  # noqa: F401

    import jaxid.api
    import jaxid.data.io
    import jaxid.models.effects
    import jaxid.report
    import jaxid.report.figures  # noqa: F401  # imported, not used: a fork of a process that has computed would hang

    rows = []
    for check in (kills, full_disk):
        began = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            write_dataset(Path(folder) / "small")
            what, promised, found = check(Path(folder))
        rows.append(
            {
                "what": what,
                "promised": promised,
                "measured": found,
                "seconds": round(time.perf_counter() - began),
            }
        )
        print(rows[-1], flush=True)
    return {
        "title": "What a result survives",
        "text": (__doc__ or "").partition("\n\n")[2].replace("\n", " ").strip(),
        "rows": rows,
    }


def started(command: str, home: Path, out: Path, seed: int, told: Path, ready: bool = True) -> int:
    """A process that runs the command; its words go into the file `told`. `ready`: with the numbers
    of an earlier run.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    if pid := os.fork():
        return pid
    with open(told, "wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    import jaxid
    from jaxid.cli.app import main as command_line

    code, verb, stored = 99, getattr(jaxid, command), home / f"{command}.pickle"
    try:
        if ready:
            result = pickle.loads(stored.read_bytes())
            setattr(jaxid, command, lambda *a, seed, **k: replace(result, seed=seed))
        else:
            setattr(jaxid, command, lambda *a, **k: kept(verb(*a, **k), stored))
        sys.stdout, sys.stderr = (
            io.TextIOWrapper(io.FileIO(fd, "w", closefd=False), write_through=True) for fd in (1, 2)
        )
        code = command_line(
            [
                command,
                str(home / "small"),
                "--out",
                str(out),
                "--seed",
                str(seed),
                "--quiet",
                *COMMANDS[command],
            ]
        )
    finally:
        os._exit(code)


def kept(result: Any, path: Path) -> Any:
    """The result; what of it draws no pictures is kept in a file."""

    def plain(fit):
        return replace(fit, traces=(), history=())

    if isinstance(result, Diagnosis):
        fits = {"nominal": plain(result.nominal), "final": plain(result.final)}
        stored = replace(result, rivals=None, traces=(), missing_force=(), regimes=(), **fits)
    else:
        stored = plain(result)
    path.write_bytes(pickle.dumps(stored))
    return result


def ended(pid: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def seed_of(out: Path, stem: str) -> int:
    """The seed of the one whole result in the folder; page and JSON belong together."""
    content = (out / f"{stem}.json").read_bytes()
    assert result_of((out / "report.html").read_bytes()) == (
        f"{stem}.json",
        hashlib.sha256(content).hexdigest(),
    )
    return json.loads(content)["seed"]


def others(out: Path, stem: str) -> set[str]:
    """Whatever else lies there."""
    return {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()} - {
        f"{stem}.json",
        "report.html",
    }


def kills(home: Path) -> tuple[str, str, str]:
    rng, ends, found, spent, partial = random.Random(21), Counter(), Counter(), [], 0
    count, told = max(8, round(200 * SHARE)), home / "told"
    for command, stem in STEMS.items():
        out, lengths = home / command, []
        for ready in (False, False, True):  # the first fills the cache of programs
            began = time.monotonic()
            assert ended(started(command, home, out, 1, told, ready)) == 0, told.read_text()
            lengths.append(time.monotonic() - began)
        (out / "notes.txt").write_text("mine")
        old = 1
        for k in range(count // 2):
            new, number = old + 1, SIGNALS[k % 4]
            whole = k % 16 == k // 16 % 4  # each signal in its turn
            pid, done = started(command, home, out, new, told, not whole), False
            if k % 8 < 4:
                time.sleep(rng.uniform(0.0, 1.05 * lengths[1 if whole else 2]))
            else:
                while (
                    not (done := os.waitpid(pid, os.WNOHANG)[0] == pid)
                    and not (out / STAGE).exists()
                ):
                    time.sleep(0.0005)
                time.sleep(rng.uniform(0.0, 0.01))
            sent = time.monotonic()
            if not done:
                os.kill(pid, number)
                code = ended(pid)
                spent += [] if number == signal.SIGKILL else [time.monotonic() - sent]
                ends[code] += 1
            now = seed_of(out, stem)  # as whoever opens the folder finds it
            assert now in (old, new), (old, new, now)
            assert (out / "notes.txt").read_text() == "mine"
            left = others(out, stem) - {"notes.txt"}
            partial += any(name.startswith("partial/") for name in left)
            stray = {name for name in left if not name.startswith(("partial/", STAGE))}
            assert not stray and (
                number == signal.SIGKILL or not any(name.startswith(STAGE) for name in left)
            ), left
            settle(out)
            assert seed_of(out, stem) == now and not (out / STAGE).exists()
            found["new" if now == new else "old"] += 1
            old = now
    exits = ", ".join(f"{n} with {code}" for code, n in sorted(ends.items()))
    return (
        f"{count} signals (INT, TERM, HUP, KILL) while `fit` and `diagnose` replace a result",
        "one whole result, old or new, whose page and JSON belong together; files of others untouched",
        f"{found['old']} old, {found['new']} new, 0 mixed; exit codes: {exits}; {partial} left something in partial/; "
        f"INT, TERM and HUP end it after {statistics.median(spent):.2f} s (longest {max(spent):.1f} s)",
    )


def full_disk(home: Path) -> tuple[str, str, str]:
    """A file system of memory that has room for ever more of the new result; needs the right to
    mount.
    """
    points, refused, kept, place = max(6, round(60 * SHARE)), 0, 0, home / "disk"
    place.mkdir()
    told, saved = home / "told", 0
    for ready in (False, True):
        assert ended(started("fit", home, home / "ready", 1, told, ready)) == 0, told.read_text()
    size = sum(p.stat().st_size for p in (home / "ready").iterdir())
    for point in range(points):
        room = int(size * (1 + 3.5 * point / points)) // 4096 * 4096 + 4096
        subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={room}", "tmpfs", str(place)], check=True
        )
        try:
            out = place / "o"
            shutil.copytree(home / "ready", out)
            code = ended(started("fit", home, out, 2, told))
            words = told.read_text()
            now = seed_of(out, "fit")
            assert not others(out, "fit") - {"partial/fit.json"}, others(out, "fit")
            assert (code, now) in ((0, 2), (1, 1)), (code, now, words)
            if code:
                assert str(out) in words and "bytes are needed" in words and "inertia" in words, (
                    words
                )
                refused += 1
                kept += bool(others(out, "fit"))
            else:
                saved += 1
        finally:
            with contextlib.suppress(subprocess.CalledProcessError):
                subprocess.run(["umount", str(place)], check=True)
    return (
        f"disk full at each of {points} points of a result of {size:,} bytes that replaces another",
        "the old result as it was, path and bytes needed, the answer printed, exit code 1; or the new one",
        f"{refused} refused and printed, the old result whole ({kept} with the new JSON in partial/); {saved} had room",
    )


if __name__ == "__main__":
    main()
