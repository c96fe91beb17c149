"""What a study survives, at full counts: kills, dying solvers, flipped bits, full disks, several
coordinators, mutated files.

    make benchmark-reliability          # or: python benchmarks/run_all.py reliability

The fleet calculates instead of fitting (tests/study_fleet.py), so that many kills take minutes; one
row kills the real command. `JAXID_RELIABILITY=0.1` runs a tenth of the counts.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

from jaxid.study import read_study, run_study, study_status
from jaxid.study.rows import StudyRow
from jaxid.study.store import Store, StoreError
from tests.study_fleet import number
from tests.test_batch import acknowledged, rows_of, SOLVE, start, table, write_dataset, write_study
from tests.test_batch_hostile import rich_study, survives


SHARE = float(os.environ.get("JAXID_RELIABILITY", "1"))
TEXT = (
    "Each row is a promise of `jaxid batch` and what was counted. The rows with kill -9 end the coordinator at random moments, "
    "start it again and compare the final table with that of a run without kills."
)


def main() -> dict:
    rows = []
    for check in (kills, kills_of_fits, poison, flips, full_disk, coordinators, signals, mutations):
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
        "title": "What a study survives",
        "text": TEXT,
        "rows": rows,
    }


def times(count: int) -> int:
    return max(2, round(SHARE * count))


def killed(study: Path, command: list[str], rng: random.Random, longest_s: float) -> bool:
    """Starts a coordinator and kills it at a random moment; whether it was still at work."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    until = time.monotonic() + rng.uniform(0.3, longest_s)
    while time.monotonic() < until and process.poll() is None:
        time.sleep(0.02)
    alive = process.poll() is None
    children = psutil.Process(process.pid).children(recursive=True) if alive else []
    process.kill()
    process.wait()
    _, left = psutil.wait_procs(children, timeout=20)
    assert not left, "a solver was left behind"
    return alive


def many_kills(
    home: Path, study: Path, command, count: int, longest_s: float, plain: list[dict]
) -> tuple[int, int, int]:
    """(kills that hit, studies completed, acknowledged results that were lost); each completed
    table is compared.
    """
    rng, hits, studies, lost = random.Random(11), 0, 0, 0
    known: set[str] = set()
    total = len(read_study(study).tasks)
    while hits < count or known:
        if hits < count:
            hits += killed(study, command(study), rng, longest_s)
        else:
            subprocess.run(command(study), stdout=subprocess.DEVNULL, check=True)
        now = acknowledged(study)
        lost += len(known - now)
        known = now
        if len(known) == total:
            subprocess.run(command(study), stdout=subprocess.DEVNULL, check=True)
            assert table(home / "out") == plain, (
                "the table differs from that of an uninterrupted run"
            )
            with sqlite3.connect(home / "out" / "study.sqlite") as db:
                assert db.execute(
                    "SELECT count(*), count(DISTINCT key) FROM results"
                ).fetchone() == (total, total)
            assert not list((home / "out").rglob("*.partial"))
            studies, known = studies + 1, set()
            shutil.rmtree(home / "out")
    return hits, studies, lost


def kills(home: Path) -> tuple[str, str, str]:
    study = write_study(home, "seeds = 200", store="out")
    run_study(study, workers=2, solver=SOLVE, check=False)
    plain = table(home / "out")
    assert [r["loss"] for r in plain] == [1 + number(k) for k in read_study(study).tasks]
    shutil.rmtree(home / "out")
    solver = str(Path(SOLVE[0]))

    def command(study):
        return [
            sys.executable,
            solver,
            "run",
            str(study),
            "--workers",
            "2",
            "--",
            "--sleep",
            "0.2",
        ]

    hits, studies, lost = many_kills(home, study, command, times(200), 6.0, plain)
    return (
        f"kill -9 at {hits} random moments of a 200-task study",
        "every acknowledged result there, each task once, the table of an uninterrupted run",
        f"{lost} lost, {studies} complete tables, all equal",
    )


def kills_of_fits(home: Path) -> tuple[str, str, str]:
    study = write_study(home, "effects = [[], ['dead_zone']]", "seeds = 60", store="out")

    def command(study):
        return [
            sys.executable,
            "-m",
            "jaxid.cli",
            "batch",
            str(study),
            "--workers",
            "2",
            "--quiet",
        ]

    subprocess.run(command(study), check=True)
    plain = table(home / "out")
    shutil.rmtree(home / "out")
    hits, studies, lost = many_kills(home, study, command, times(20), 25.0, plain)
    return (
        f"kill -9 at {hits} random moments of `jaxid batch` with 120 fits by lm",
        "the same bits as an uninterrupted run",
        f"{lost} lost, {studies} complete tables, all equal",
    )


def poison(home: Path) -> tuple[str, str, str]:
    count = times(1000)
    study = write_study(home, f"seeds = {count}")
    process = start(study, "--sleep", "0.02", "--poison", str(count // 2))
    rng, deaths = random.Random(12), 0
    while process.poll() is None:
        time.sleep(rng.uniform(0.2, 1.0))
        try:
            rng.choice(psutil.Process(process.pid).children()).kill()
            deaths += 1
        except (psutil.Error, IndexError):
            pass
    status = json.loads(process.communicate()[0])
    outcomes = study_status(study)[1]
    crashed = [o for o in outcomes.values() if o.status == "crashed"]
    assert (status["done"], status["failed"], len(crashed)) == (count - 1, 1, 1), status
    return (
        f"{count} tasks, one that kills its process, {deaths} processes killed at random",
        f"{count - 1} results and one `crashed`",
        f"{status['done']} results, {len(crashed)} crashed ({crashed[0].reason})",
    )


def flips(home: Path) -> tuple[str, str, str]:
    count, rng, found = times(1000), random.Random(13), 0
    folder = home / "out"
    with Store(folder) as store:
        store.acquire()
        store.save(rows_of(100, 400))
    clean = (folder / "study.sqlite").read_bytes()
    for _ in range(count):
        row = rng.choice(rows_of(100, 400))
        damaged = bytearray(clean)
        damaged[clean.index(row.body) + rng.randrange(len(row.body))] ^= 1 << rng.randrange(8)
        (folder / "study.sqlite").write_bytes(damaged)
        with Store(folder) as store:
            found += store.acquire() == 1 and {r.key for r in store.rows()} == {
                r.key for r in rows_of(100)
            } - {row.key}
    assert found == count
    return (
        f"{count} random bits flipped in payloads",
        "each found, all others kept",
        f"{found} found",
    )


def full_disk(home: Path) -> tuple[str, str, str]:
    refused, folder = 0, home / "out"
    with Store(folder) as store:
        store.acquire()
        store.save(rows_of(50))
        (pages,) = store.db.execute("PRAGMA page_count").fetchone()
        for room in range(60):
            store.db.execute(f"PRAGMA max_page_count = {pages + room}")
            try:
                store.save(
                    [
                        StudyRow(f"new {k}", r.status, r.body)
                        for k, r in enumerate(rows_of(400, 2000))
                    ]
                )
            except StoreError as error:
                refused += "the disk is full" in str(error)
            assert len(list(store.rows())) == 50
            assert store.db.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert refused == 60
    return (
        "disk full at each of 60 pages of a transaction",
        "nothing saved is lost, a message says what to do",
        f"{refused} of 60",
    )


def coordinators(home: Path) -> tuple[str, str, str]:
    study, count = write_study(home, "seeds = 100"), times(20)
    ran, refused = 0, 0
    for _ in range(count):
        shutil.rmtree(home / "out", ignore_errors=True)
        started = [start(study, "--sleep", "0.01") for _ in range(4)]
        for p in started:
            _, err = p.communicate(timeout=300)
            ran, refused = (
                ran + (p.returncode == 0),
                refused + (p.returncode == 2 and "is being run by process" in err),
            )
        with sqlite3.connect(home / "out" / "study.sqlite") as db:
            assert db.execute("SELECT count(*), count(DISTINCT key) FROM results").fetchone() == (
                100,
                100,
            )
    assert ran + refused == 4 * count
    return (
        f"4 coordinators started on one store, {count} times",
        "one result a task, the others are told who runs it",
        f"100 of 100 results each time; {refused} refused, {ran} ran or found it done",
    )


def signals(home: Path) -> tuple[str, str, str]:
    spent, rng = [], random.Random(14)
    for k in range(times(20)):
        study = write_study(home, "seeds = 400", store=f"out{k}")
        process = start(study, "--sleep", "0.05", "--hang", "3")
        until = time.monotonic() + 60
        while time.monotonic() < until and not study_status(study)[2].done:
            time.sleep(0.05)
        time.sleep(rng.uniform(0, 1))
        known, began = acknowledged(study), time.monotonic()
        process.send_signal(signal.SIGTERM if k % 2 else signal.SIGINT)
        process.communicate(timeout=60)
        spent.append(time.monotonic() - began)
        assert process.returncode == 130 and known <= acknowledged(study)
    return (
        f"{len(spent)} times Ctrl-C or SIGTERM while a task hangs",
        "saved and out within 2 s, exit code 130",
        f"median {statistics.median(spent):.2f} s, longest {max(spent):.2f} s",
    )


def mutations(home: Path) -> tuple[str, str, str]:
    files, count = rich_study(home), times(10_000)
    began = time.perf_counter()
    ends = survives(home, files, random.Random(15), count, 5.0)
    each = 1000 * (time.perf_counter() - began) / count
    return (
        f"{count} mutated study and dataset files",
        "read or refused with a clear error, none takes 5 s",
        f"{ends['refused']} refused, {ends['read']} read, nothing else; {each:.0f} ms each",
    )
