"""`jaxid batch`: what a study is, and that its results survive kills, crashes, full disks, flipped
bits and hostile names.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import resource
import signal
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import psutil
import pyarrow.parquet
import pytest

import jaxid
from jaxid.cli import app as cli
from jaxid.study import cluster, lease, read_study, run_study, store as stores, study_status
from jaxid.study.plan import StudyError
from jaxid.study.rows import StudyRow
from jaxid.study.store import LeaseLost, Store, StoreError
from study_fleet import number


FLEET = str(Path(__file__).with_name("study_fleet.py"))
SOLVE = (FLEET, "solve")
TIMES = ("wall_time_s", "compile_time_s")


def quoted(text: str) -> str:
    """A text as TOML writes it."""
    return json.dumps(text, ensure_ascii=False)


def write_dataset(folder: Path, name: str = "small", samples: int = 200) -> Path:
    """A joint driven by two sines, integrated by small steps of Euler's method."""
    folder.mkdir(parents=True, exist_ok=True)
    t = np.arange(samples) / 100
    u = 2 * np.sin(2 * np.pi * 0.7 * t) + 1.5 * np.sin(2 * np.pi * 1.9 * t + 1)
    q, v, x = np.zeros(samples), 0.0, 0.0
    for k in range(samples):
        q[k] = x
        for _ in range(20):
            v += 0.0005 * (u[k] - 0.4 * v - 0.3 * np.tanh(v / 1e-3)) / 0.1
            x += 0.0005 * v
    q += 1e-3 * np.random.default_rng(0).standard_normal(samples)
    rows = "\n".join(f"{a:.6f},{b:.9g},{c:.9g}" for a, b, c in zip(t, u, q, strict=True))
    (folder / "run.csv").write_text(f"t,tau,q\n{rows}\n")
    (folder / "dataset.toml").write_text(
        f"name = {quoted(name)}\n[model]\nname = 'joint'\n"
        "[channels.tau]\nrole = 'input'\nunit = 'N m'\n[channels.q]\nrole = 'output'\nunit = 'rad'\nnoise_std = 1e-3\n"
        "[[experiments]]\nfile = 'run.csv'\nat_rest = true\n"
    )
    return folder


def write_study(folder: Path, *lines: str, name: str = "study", store: str = "out") -> Path:
    """A study of one `[[runs]]`."""
    runs = lines or ("seeds = 4",)
    path = folder / "study.toml"
    body = "\n".join(runs)
    path.write_text(
        f"name = {quoted(name)}\nstore = {quoted(store)}\n[[runs]]\ncommand = 'fit'\ndatasets = ['small']\n{body}\n"
    )
    return path


@pytest.fixture
def home(tmp_path):
    write_dataset(tmp_path / "small")
    return tmp_path


def start(study: Path, *solver: str, workers: int = 2, **more) -> subprocess.Popen[str]:
    """A process that coordinates solvers which only calculate."""
    command = [sys.executable, FLEET, "run", str(study), "--workers", str(workers), "--", *solver]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **more
    )
    STARTED.append(process)
    return process


STARTED: list[subprocess.Popen[str]] = []


@pytest.fixture(autouse=True)
def nothing_left():
    """Ends what a test that failed has left running; its solvers end with it."""
    yield
    while STARTED:
        process = STARTED.pop()
        if process.poll() is None:
            process.kill()
            process.communicate()


def fleet(study: Path, *solver: str, **more) -> tuple[int, dict, str]:
    """Exit code, final status and errors of such a process."""
    process = start(study, *solver, **more)
    out, err = process.communicate(timeout=120)
    return process.returncode, json.loads(out.splitlines()[-1]) if out.strip() else {}, err


def table(folder: Path) -> list[dict]:
    rows = pyarrow.parquet.read_table(folder / "runs.parquet").to_pylist()
    return [{k: v for k, v in row.items() if k not in TIMES} for row in rows]


def acknowledged(study: Path) -> set[str]:
    return {k for k, o in study_status(study)[1].items() if not o.failed}


# ---- the study file


def test_product_in_order_and_keys(home):
    write_dataset(home / "other", "other", 150)
    study = write_study(
        home, "effects = [[], ['dead_zone']]", "fitters = ['lm', 'de']", "seeds = 3"
    )
    study.write_text(study.read_text().replace("['small']", "['small', 'other']"))
    tasks = list(read_study(study).tasks.values())
    assert len(tasks) == 2 * 2 * 2 * 3
    assert [t.seed for t in tasks[:4]] == [0, 1, 2, 0] and {t.label for t in tasks} == {
        "small",
        "other",
    }
    assert all(t.system == "joint" for t in tasks)
    for t in tasks:
        assert t.dataset_sha256 == jaxid.load_dataset(t.dataset).sha256
    before = set(read_study(study).tasks)
    with open(home / "other" / "run.csv", "a") as file:
        file.write("1.51,0.1,0.2\n")
    assert (
        len(before & set(read_study(study).tasks)) == 12
    )  # only what depends on the changed recording is new
    study.write_text(study.read_text().replace("seeds = 3", "seeds = [7, 1, 2, 0]"))
    assert len(before & set(read_study(study).tasks)) == 12  # of `small`: the seeds 0 to 2
    study.write_text(study.read_text().replace("['lm', 'de']", "['lm', 'de']\nbudget = 50"))
    assert not before & set(read_study(study).tasks)


def test_effects_without_their_brackets_are_told_how_to_write_them(home):
    study = write_study(home, "effects = ['dead_zone', 'input_delay']")
    with pytest.raises(StudyError) as refused:
        read_study(study)
    for words in ('[["dead_zone", "input_delay"]]', '[["dead_zone"], ["input_delay"]]'):
        assert words in str(refused.value)


def test_every_mistake_at_once_with_the_nearest_name(home):
    study = write_study(
        home,
        "models = ['jont', 'tracker']",
        "effects = [['ded_zone']]",
        "fitters = ['lmm', 'iv']",
        "sedes = 3",
        "residual = 'output_error'",
    )
    study.write_text(
        study.read_text().replace("['small']", "['small', 'smal']")
        + "[[runs]]\ncommand = 'diagnos'\ndatasets = []\n"
    )
    with pytest.raises(StudyError) as refused:
        from jaxid.study import check_study

        check_study(study)
    text = str(refused.value)
    for words in (
        "'sedes' (did you mean 'seeds'?)",
        "'jont' (did you mean 'joint'?)",
        "'ded_zone' (did you mean 'dead_zone'?)",
        "'lmm' (did you mean 'lm'?)",
        "'smal' is not a folder",
        "'diagnos' (did you mean 'diagnose'?)",
        "datasets' is an empty list",
        "iv solves inverse_dynamics",
        "model tracker needs inputs",
    ):
        assert words in text, (words, text)
    assert "runs[1].models" in text and "row 6" in text
    assert not (home / "out").exists()


def test_refusals_of_the_command(home, capsys):
    assert cli.main(["batch", str(home / "none.toml")]) == 2
    assert "there is no such file" in capsys.readouterr().err
    study = write_study(home, "seeds = 2000000")
    assert cli.main(["batch", str(study), "--status"]) == 2
    assert "more than a study can hold" in capsys.readouterr().err
    study = write_study(home, "command = 'fit'")
    assert cli.main(["batch", str(study)]) == 2
    assert "not readable as TOML" in capsys.readouterr().err


# ---- real fits


def test_fits_equal_those_of_the_function(home, capsys, monkeypatch):
    """The command, interrupted and started again, against `jaxid.fit`; then a changed study runs
    only what changed.
    """
    study = write_study(home, "seeds = 3")
    assert cli.main(["batch", str(study), "--status", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"total": 3, "done": 0, "failed": 0, "running": 0}
    assert cli.main(["batch", str(study), "--workers", "1", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["done"] == 3 and found["new"] == 3 and found["fitters"][0]["fitter"] == "lm"
    data = jaxid.load_dataset(home / "small")
    names = [
        "dataset",
        "model",
        "effects",
        "fitter",
        "seed",
        "status",
        "loss",
        "evaluations",
        "wall_time_s",
        "compile_time_s",
    ]
    rows = pyarrow.parquet.read_table(home / "out" / "runs.parquet")
    assert rows.column_names == [*names, "inertia", "viscous", "coulomb", "offset"]
    for row in rows.to_pylist():
        fit = jaxid.fit("joint", data, seed=row["seed"])
        assert (
            row["loss"] == fit.loss
            and row["evaluations"] == fit.evaluations
            and row["status"] == "converged"
        )
        assert {n: row[n] for n in fit.parameters} == {
            n: p.value for n, p in fit.parameters.items()
        }
    study.write_text(study.read_text().replace("seeds = 3", "seeds = 4"))
    assert cli.main(["batch", str(study), "--status", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"total": 4, "done": 3, "failed": 0, "running": 0}
    assert cli.main(["batch", str(study), "--workers", "1"]) == 0
    assert "4 of 4 tasks have a result, 0 failed (1 run now" in capsys.readouterr().out
    assert len(table(home / "out")) == 4
    with Store(home / "out", writable=False) as store:
        first = next(store.rows())
        result = json.loads(first.body)["result"]
        assert result["kind"] == "fit" and result["parameters"]["inertia"]["unit"] == "kg m^2"
        assert store.arrays(first)["history"].shape[1] == 2


# ---- kills


@pytest.mark.slow
def test_ten_kills(home):
    """Kill -9 at random moments: every acknowledged result stays, and the table is that of a run
    without kills.
    """
    study = write_study(home, "seeds = 60")
    rng, kills, known = random.Random(1), 0, set()
    while kills < 10:
        process = start(study, "--sleep", "0.04")
        until = time.monotonic() + rng.uniform(0.6, 2.0)
        while time.monotonic() < until and process.poll() is None:
            time.sleep(0.02)
        children = (
            psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
        )
        process.kill()
        process.communicate()
        kills += 1
        now = acknowledged(study)
        assert known <= now
        known = now
        psutil.wait_procs(children, timeout=5)
        assert not any(c.is_running() for c in children)  # no solver is left behind
    code, status, err = fleet(study)
    assert code == 0 and status["done"] == 60 and status["new"] == 60 - len(known), err
    assert [row["loss"] for row in table(home / "out")] == [
        1 + number(k) for k in read_study(study).tasks
    ]
    assert [r["loss"] for r in table(home / "out")] == [
        r["loss"] for r in uninterrupted(home, study)
    ]
    assert not list((home / "out").rglob("*.partial"))
    with sqlite3.connect(home / "out" / "study.sqlite") as db:
        assert db.execute("SELECT count(*), count(DISTINCT key) FROM results").fetchone() == (
            60,
            60,
        )


def uninterrupted(home: Path, study: Path) -> list[dict]:
    other = home / "straight.toml"
    other.write_text(study.read_text().replace('"out"', '"straight"'))
    result = run_study(other, workers=2, solver=SOLVE, check=False)
    assert result.complete
    return table(home / "straight")


@pytest.mark.parametrize("together", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_poison_and_random_deaths(home, together):
    """One task kills its process each time, and processes are killed at random: all others have a
    result.
    """
    study = write_study(home, "seeds = 100")
    process = start(
        study, "--sleep", "0.01", "--poison", "37", *(["--together"] if together else [])
    )
    rng, killed, done = random.Random(2), 0, 0
    while process.poll() is None and killed < 5:
        time.sleep(rng.uniform(0.1, 0.4))
        if (now := study_status(study)[2].done) == done:
            continue  # who dies while it starts, again and again, ends the study: another test
        with contextlib.suppress(psutil.Error, IndexError):
            rng.choice(psutil.Process(process.pid).children()).kill()
            killed, done = killed + 1, now
    assert killed > 0
    out, err = process.communicate(timeout=100)
    status = json.loads(out)
    outcomes = study_status(study)[1]
    failed = {t.seed: o for t in read_study(study).tasks.values() if (o := outcomes[t.key]).failed}
    # By chance the kills may hit any task twice, which then counts as crashed too, and also the one
    # that is about to die.
    assert all(o.status == "crashed" and "2 times" in o.reason for o in failed.values())
    others = len(failed) - 1
    assert 37 in failed and others <= killed // 2
    assert (status["done"], status["failed"], process.returncode) == (99 - others, 1 + others, 1), (
        err
    )
    code, status, _ = fleet(study)  # a crash is a result too
    assert code == 1 and status["new"] == 0
    poison = run_study(
        study, workers=2, retry=True, solver=(*SOLVE, "--poison", "37"), check=False
    )  # and nobody kills
    assert poison.new == 1 + others and poison.status.failed == 1
    crashed = study_status(study)[1][
        next(t.key for t in read_study(study).tasks.values() if t.seed == 37)
    ]
    assert (
        crashed.status == "crashed"
        and "SIGABRT, 2 times" in crashed.reason
        and "about to die of seed 37" in crashed.log
    )
    result = run_study(study, workers=1, retry=True, solver=SOLVE, check=False)
    assert result.new == 1 and result.status.failed == 0


def test_time_limit_failures_and_exceptions(home):
    study = write_study(home, "seeds = 20", "timeout_s = 3")
    for extra in ([], ["--together"]):
        code, status, err = fleet(study, "--hang", "3", "--fail", "5", "--raise", "7", *extra)
        assert code == 1 and (status["done"], status["failed"]) == (17, 3), err
        by_seed = {t.seed: study_status(study)[1][k] for k, t in read_study(study).tasks.items()}
        assert by_seed[3].status == "timeout" and "3 s" in by_seed[3].reason
        assert by_seed[5].status == "failed" and by_seed[5].reason == "it diverges"
        assert (
            by_seed[7].status == "failed"
            and "a solver's mistake" in by_seed[7].reason
            and "RuntimeError" in by_seed[7].log
        )
        study.write_text(study.read_text().replace('"out"', '"out2"'))
    page = (home / "out" / "report.html").read_text()
    assert "it diverges" in page and "took more than 3 s" in page


def test_a_solver_that_never_starts_ends_the_study(home):
    study = write_study(home, "seeds = 20")
    with pytest.raises(
        RuntimeError,
        match="no solver can be started: its process ended with code 3\nno module named jax",
    ):
        run_study(study, workers=2, solver=(*SOLVE, "--broken"), check=False)
    assert run_study(study, workers=2, solver=SOLVE, check=False).status.done == 20


@pytest.mark.parametrize(
    "number, ignored", [(signal.SIGINT, False), (signal.SIGINT, True), (signal.SIGTERM, False)]
)
def test_signals_save_and_leave(home, number, ignored):
    """Within 2 s even where a task takes minutes, also as a background job of a shell, with SIGINT
    ignored; what was finished is there, and the study goes on.
    """
    study = write_study(home, "seeds = 40")
    handler = signal.SIG_IGN if ignored else signal.SIG_DFL
    process = start(
        study,
        "--sleep",
        "0.05",
        "--hang",
        "30",
        preexec_fn=lambda: signal.signal(signal.SIGINT, handler),
    )
    until = time.monotonic() + 100
    while time.monotonic() < until and study_status(study)[2].done < 5:
        time.sleep(0.1)
    live = study_status(study)[2]
    assert live.done >= 5 and live.running > 0 and live.total == 40
    process.send_signal(number)
    began = time.monotonic()
    out, err = process.communicate(timeout=20)
    assert process.returncode == 130 and time.monotonic() - began < 4, (
        err
    )  # 2 s, and a loaded machine
    assert json.loads(out)["done"] >= live.done
    assert study_status(study)[2].running == 0
    code, status, _ = fleet(study)
    assert code == 0 and status["done"] == 40


@pytest.mark.skipif(
    threading.current_thread() is not threading.main_thread(),
    reason="signals come to the main thread",
)
def test_a_cluster_that_does_not_close_holds_nothing_up(home, monkeypatch):
    """On a crowded computer dask takes all the time that it is given; what was finished is on the
    disk long before.
    """
    import distributed

    def stuck(self, timeout: float, **more):
        left.append(self)
        time.sleep(timeout)
        raise TimeoutError

    left, sent = [], []
    closing = {kind: kind.close for kind in (distributed.Client, distributed.LocalCluster)}
    for kind in closing:
        monkeypatch.setattr(kind, "close", stuck)

    def heard(progress):
        if progress.new > 3 and not sent:
            sent.append((time.monotonic(), progress.new))
            os.kill(os.getpid(), signal.SIGTERM)

    study = write_study(home, "seeds = 200")
    try:
        result = run_study(
            study,
            workers=2,
            solver=(*SOLVE, "--sleep", "0.02", "--hang", "20"),
            check=False,
            heard=heard,
        )
        ((began, finished),) = sent
        assert result.interrupted and len(left) == 2 and time.monotonic() - began < 2.5
        assert len(acknowledged(study)) == result.new >= finished
    finally:
        monkeypatch.undo()
        for part in left:
            with contextlib.suppress(TimeoutError):
                closing[type(part)](part, timeout=10)


# ---- the store


def rows_of(n: int, size: int = 200) -> list[StudyRow]:
    return [
        StudyRow(f"{k:032x}", "converged", json.dumps({"loss": k, "reason": "x" * size}).encode())
        for k in range(n)
    ]


def test_status_while_the_store_is_being_made(home):
    study = write_study(home)
    (home / "out").mkdir()
    (home / "out" / "study.sqlite").touch()
    assert study_status(study)[2].to_dict() == {"total": 4, "done": 0, "failed": 0, "running": 0}


def test_two_coordinators(home, monkeypatch):
    study = write_study(home, "seeds = 40")
    process = start(study, "--sleep", "0.05")
    until = time.monotonic() + 100
    while time.monotonic() < until and study_status(study)[2].done < 2:
        time.sleep(0.05)
    code, _, err = fleet(study)
    assert code == 2 and f"is being run by process {process.pid} on" in err
    assert process.wait(timeout=60) == 0
    process.communicate()
    with sqlite3.connect(home / "out" / "study.sqlite") as db:
        assert db.execute("SELECT count(*), count(DISTINCT key) FROM results").fetchone() == (
            40,
            40,
        )
    # A process that slept through its lease finds that another took over, and saves nothing.
    first = Store(home / "out")
    first.acquire()
    monkeypatch.setattr(stores, "alive", lambda held: False)
    with Store(home / "out") as second:
        second.acquire()
        with pytest.raises(LeaseLost, match="another process has taken"):
            first.save(rows_of(1))
        second.save(rows_of(2))
        second.save(
            [StudyRow(rows_of(1)[0].key, "failed", b"{}")]
        )  # a task that has a result keeps it
        kept = {r.key: r.status for r in second.rows()}
        assert len(kept) == 42 and kept[rows_of(1)[0].key] == "converged"
    first.close()


def test_lease_of_the_dead_and_of_other_machines(tmp_path):
    with Store(tmp_path) as store:
        store.acquire()
        store.db.execute("UPDATE lease SET pid = 999999999")
        with Store(tmp_path) as other:
            other.acquire()  # its process is gone
            other.db.execute(
                "UPDATE lease SET host = 'elsewhere/1', renewed = ?", (time.time() - 10,)
            )
            with pytest.raises(StoreError, match="on elsewhere"), Store(tmp_path) as third:
                third.acquire()
            other.db.execute("UPDATE lease SET renewed = ?", (time.time() - 2 * lease.LEASE_S,))
            with Store(tmp_path) as third:
                third.acquire()


def test_every_flipped_byte_in_a_payload_is_found(tmp_path):
    with Store(tmp_path) as store:
        store.acquire()
        store.save(rows_of(30))
    clean, rng = (tmp_path / "study.sqlite").read_bytes(), random.Random(3)
    for _ in range(60):
        row = rng.choice(rows_of(30))
        at = clean.index(row.body) + rng.randrange(len(row.body))
        damaged = bytearray(clean)
        damaged[at] ^= 1 << rng.randrange(8)
        (tmp_path / "study.sqlite").write_bytes(damaged)
        with Store(tmp_path) as store:
            assert store.acquire() == 1
            assert {r.key for r in store.rows()} == {r.key for r in rows_of(30)} - {row.key}
            store.save([row])
            assert len(list(store.rows())) == 30


def test_any_damage_leaves_sound_rows_or_a_clear_message(tmp_path):
    """Bytes flipped and blocks overwritten anywhere in the file: no wrong row, no traceback, and
    the store works again.
    """
    with Store(tmp_path) as store:
        store.acquire()
        store.save(rows_of(200, 600))
    clean, rng, truth = (
        (tmp_path / "study.sqlite").read_bytes(),
        random.Random(4),
        {r.key: r for r in rows_of(200, 600)},
    )
    kept = []
    for trial in range(30):
        damaged = bytearray(clean)
        if trial % 2:
            page = 4096 * rng.randrange(len(clean) // 4096)
            damaged[page : page + 4096] = rng.randbytes(4096)
        else:
            for _ in range(20):
                damaged[rng.randrange(len(damaged))] ^= 1 << rng.randrange(8)
        for path in tmp_path.glob("study.sqlite*"):
            path.unlink()
        (tmp_path / "study.sqlite").write_bytes(damaged)
        with Store(tmp_path) as store:
            store.acquire()
            found = list(store.rows())
            assert all(truth[r.key] == r for r in found)
            kept.append(len(found))
            store.save(list(truth.values()))
            assert {r.key for r in store.rows()} == set(truth)
    assert np.median(kept) > 150


def test_a_damaged_store_is_mended_by_the_study(home):
    study = write_study(home, "seeds = 300")
    run_study(study, workers=2, solver=SOLVE, check=False)
    before, path = table(home / "out"), home / "out" / "study.sqlite"
    content = bytearray(path.read_bytes())
    content[8 * 4096 : 9 * 4096] = bytes(4096)
    path.write_bytes(content)
    result = run_study(study, workers=2, solver=SOLVE, check=False)
    assert result.complete and 0 < result.new < 300 and "damaged" in " ".join(result.notes)
    assert table(home / "out") == before and (home / "out" / "study.sqlite.damaged-1").exists()


def test_full_disk(tmp_path):
    """SQLite's own word for it, at every page: nothing that was saved is lost, the message says
    what to do.
    """
    with Store(tmp_path) as store:
        store.acquire()
        store.save(rows_of(50))
        (pages,) = store.db.execute("PRAGMA page_count").fetchone()
        for room in range(6):
            store.db.execute(f"PRAGMA max_page_count = {pages + room}")
            with pytest.raises(
                StoreError, match="the disk is full; 400 finished tasks could not be saved"
            ) as error:
                store.save(
                    [
                        StudyRow(f"new {k}", r.status, r.body)
                        for k, r in enumerate(rows_of(400, 2000))
                    ]
                )
            assert str(tmp_path) in str(error.value) and "start the same command again" in str(
                error.value
            )
            assert len(list(store.rows())) == 50
        store.db.execute("PRAGMA max_page_count = 1000000")
        store.save([StudyRow("new", "converged", b"{}")])
        assert len(list(store.rows())) == 51


def test_a_study_on_a_full_disk(home):
    """No file may grow beyond 100 kB: the study stops with exit code 2 and goes on when there is
    room.
    """
    study = write_study(home, "seeds = 500")

    def limit():
        return resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))

    code, status, err = fleet(study, preexec_fn=limit)
    assert code == 2 and not status and "cannot be written" in err and "Traceback" not in err
    saved = len(acknowledged(study))
    assert 0 < saved < 500
    code, status, _ = fleet(study)
    assert code == 0 and status["done"] == 500 and status["new"] == 500 - saved


def test_read_only_store(home, monkeypatch):
    study = write_study(home)
    run_study(study, workers=1, solver=SOLVE, check=False)
    connect = sqlite3.connect

    def only(name, **more):
        return connect(name.replace("mode=rwc", "mode=ro").replace("mode=rw", "mode=ro"), **more)

    monkeypatch.setattr(stores.sqlite3, "connect", only)
    assert study_status(study)[2].done == 4
    with pytest.raises(StoreError, match="cannot be written .*readonly.*check its permissions"):
        run_study(study, workers=1, solver=SOLVE, check=False)
    monkeypatch.undo()
    for place in ("/proc/nowhere/out", str(home / "small" / "run.csv" / "out")):
        with pytest.raises(StoreError, match="cannot be made"):
            run_study(write_study(home, store=place), workers=1, solver=SOLVE, check=False)


@contextlib.contextmanager
def as_anyone():
    """As a user without rights, where this is root: whose writes no permission stops."""
    if os.geteuid() != 0:
        yield
        return
    os.setresgid(65534, 65534, 0)
    os.setresuid(65534, 65534, 0)
    try:
        yield
    finally:
        os.setresuid(0, 0, 0)
        os.setresgid(0, 0, 0)


@pytest.mark.skipif(not hasattr(os, "setresuid"), reason="needs the users of Linux")
@pytest.mark.parametrize("locked", [("study.sqlite",), (".",), ("study.sqlite", ".", "arrays")])
def test_store_without_the_right_to_write(locked):
    """File, folder or both: what is there can be read, whoever wants to write is told, nothing is
    touched.
    """
    with tempfile.TemporaryDirectory() as name:  # pytest's own folders are closed to others
        home = Path(name)
        home.chmod(0o755)
        write_dataset(home / "small")
        study = write_study(home)
        run_study(study, workers=1, solver=SOLVE, check=False)
        out = home / "out"
        for path in (out, *out.rglob("*")):
            path.chmod(0o777 if path.is_dir() else 0o666)
        for part in locked:
            (out / part).chmod(0o555 if (out / part).is_dir() else 0o444)
        content = {p: p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()}
        more = write_study(home, "seeds = 5")
        try:
            with as_anyone():
                assert not all(os.access(out / part, os.W_OK) for part in locked)
                known = study_status(more)[2]
                assert (known.done, known.total) == (4, 5)
                with pytest.raises(
                    StoreError,
                    match=r"study.sqlite: cannot be written .*check its permissions, or name another",
                ):
                    run_study(more, workers=1, solver=SOLVE, check=False)
        finally:
            for folder in (out, out / "arrays"):
                folder.chmod(0o777)
        assert {p: p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()} == content


def test_schema(tmp_path, monkeypatch):
    with Store(tmp_path) as store:
        store.acquire()
        store.save(rows_of(5))
    monkeypatch.setattr(
        stores,
        "MIGRATIONS",
        (*stores.MIGRATIONS, "ALTER TABLE meta ADD COLUMN note TEXT; CREATE TABLE more (x);"),
    )
    monkeypatch.setattr(stores, "SCHEMA", len(stores.MIGRATIONS))
    with pytest.raises(StoreError, match="older schema"):
        Store(tmp_path, writable=False)
    with Store(tmp_path) as store:
        assert (
            store.db.execute("SELECT count(note) FROM meta").fetchone() == (0,)
            and len(list(store.rows())) == 5
        )
    monkeypatch.undo()
    with pytest.raises(StoreError, match="written by a newer jaxid"):
        Store(tmp_path)
    with sqlite3.connect(
        tmp_path / "other" / "study.sqlite"
        if (tmp_path / "other").mkdir()
        else tmp_path / "other/study.sqlite"
    ) as db:
        db.execute("CREATE TABLE mine (x)")
    with pytest.raises(StoreError, match="is not the store of a study"):
        Store(tmp_path / "other")


def test_a_store_is_looked_at_as_it_was_at_one_time(tmp_path, monkeypatch):
    """`--status` while the study makes its tables: what it reads first must not be older than what
    it reads last.
    """

    class Slow:
        def __init__(self, db):
            self.db = db

        def execute(self, text, *values):
            if "sqlite_master" in text:  # here another process makes the tables, or has to wait
                with contextlib.suppress(StoreError):
                    Store(tmp_path).close()
            return self.db.execute(text, *values)

        def __getattr__(self, name):
            return getattr(self.db, name)

    sqlite3.connect(tmp_path / "study.sqlite").close()
    connect = Store._connect
    monkeypatch.setattr(stores, "BUSY_S", 0.05)
    monkeypatch.setattr(
        Store, "_connect", lambda self: connect(self) if self.writable else Slow(connect(self))
    )
    with pytest.raises(stores.NotBegun):
        Store(tmp_path, writable=False)


# ---- workers


def test_nothing_listens_and_solvers_are_threads_of_one_core(home):
    study = write_study(home, "seeds = 100")
    process = start(study, "--sleep", "0.05")
    until, solvers, listening = time.monotonic() + 100, [], []
    while time.monotonic() < until and len(solvers) < 2:
        time.sleep(0.1)
        solvers = psutil.Process(process.pid).children(recursive=True)
    time.sleep(0.3)
    for p in (psutil.Process(process.pid), *solvers):
        listening += [c.laddr for c in p.net_connections() if c.status == psutil.CONN_LISTEN]
        if p.pid != process.pid:
            assert p.environ()["OPENBLAS_NUM_THREADS"] == "1"
    process.send_signal(signal.SIGTERM)
    process.communicate()
    assert listening == [] and len(solvers) == 2


@pytest.fixture
def running_scheduler(tmp_path):
    """A scheduler and two workers as processes of their own: (address, pids of the workers)."""
    file = tmp_path / "scheduler.json"

    def part(name, *more):
        return subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{name}", "--no-dashboard", *more],
            stderr=subprocess.DEVNULL,
        )

    parts = [part("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))]
    own = (
        "--scheduler-file",
        str(file),
        "--nthreads",
        "1",
        "--no-nanny",
        "--local-directory",
        str(tmp_path),
    )
    try:
        until = time.monotonic() + 60
        while not file.exists() and time.monotonic() < until:
            time.sleep(0.1)
        parts += [part("worker", *own) for _ in range(2)]
        yield json.loads(file.read_text())["address"], [p.pid for p in parts[1:]]
    finally:
        for p in parts:
            p.kill()
            p.wait()


def test_on_a_running_cluster(home, running_scheduler, monkeypatch):
    """One of the cluster's workers is killed: its tasks move to the other, nothing is done twice,
    nothing blamed.
    """
    address, pids = running_scheduler
    killed = []

    def heard(progress):
        if progress.new > 5 and not killed:
            killed.append(psutil.Process(pids[0]).children(recursive=True))
            os.kill(pids[0], signal.SIGKILL)

    study = write_study(home, "seeds = 60")
    result = run_study(
        study, scheduler=address, solver=(*SOLVE, "--sleep", "0.05"), check=False, heard=heard
    )
    assert killed and result.complete and result.status.done == 60
    psutil.wait_procs(killed[0], timeout=5)
    assert not any(c.is_running() for c in killed[0])
    monkeypatch.setattr(cluster, "CONNECT_S", 1.0)
    with pytest.raises(jaxid.UsageError, match="no scheduler answers there"):
        run_study(
            write_study(home, "seeds = 61"),
            scheduler="tcp://127.0.0.1:9",
            solver=SOLVE,
            check=False,
        )


def test_overhead_of_the_coordinator(home):
    """Processor time of this process between the first and the last of 1,000 empty tasks: below 5
    ms a task.
    """
    course = []

    def heard(p):
        return course.append((p.new, time.process_time()))

    run_study(write_study(home, "seeds = 1000"), workers=2, solver=SOLVE, check=False, heard=heard)
    began, ended = next(c for c in course if c[0]), course[-1]
    assert ended[0] == 1000 and (ended[1] - began[1]) / (ended[0] - began[0]) < 5e-3
