"""Nothing finished is lost or mixed up: files that belong together, runs that are stopped, a full
disk, effects asked for.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

import jaxid
from jaxid.base import atomic_files, interim
from jaxid.base.atomic_files import replace_files, settle, STAGE
from jaxid.base.errors import NotSaved
from jaxid.base.small_files import LARGEST_BYTES
from jaxid.cli import app as cli
from jaxid.report import result_files
from jaxid.report.result_files import result_of
from report_sample import sample_diagnosis, sample_fit
from test_batch import write_dataset


pytestmark = pytest.mark.skipif(
    not hasattr(os, "fork"), reason="ends processes in the middle of their work"
)
OLD, NEW = (
    {"a.json": b"old a", "a.html": b"old page"},
    {"a.json": b"new", "a.html": b"new page", "t.bin": b"new table"},
)
#: What Python tells an audit hook of each act on a file.
ACTS = {
    "open",
    "os.rename",
    "os.symlink",
    "os.link",
    "os.mkdir",
    "os.remove",
    "os.rmdir",
    "os.scandir",
    "os.listdir",
}


def content(folder: Path) -> dict[str, bytes]:
    return {
        p.name: p.read_bytes() for p in folder.iterdir() if p.is_file() and p.name != "mine.txt"
    }


def forked(work) -> int:
    """The exit code of a process that does the work."""
    if not (pid := os.fork()):
        code = 99
        try:
            work()
            code = 0
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


@pytest.mark.parametrize("first", [True, False])
def test_an_end_at_any_act_leaves_the_old_or_the_new(tmp_path, first):
    """A process that ends at its k-th act on files, for every k; what it leaves is ended by the
    next one.
    """
    seen, k = [], 0
    while "done" not in seen:
        k += 1
        folder = tmp_path / str(k)
        folder.mkdir()
        (folder / "mine.txt").write_text("mine")
        old = {} if first else OLD | {"gone.html": b"obsolete"}
        if old:
            replace_files(folder, old)

        def work(folder=folder, k=k):
            count = 0

            def act(event, _):
                nonlocal count
                count += event in ACTS
                if count == k:
                    os._exit(7)

            sys.addaudithook(act)
            replace_files(folder, NEW, {"gone.html"})

        code = forked(work)
        now = content(folder)
        assert now in (old, NEW), (k, now)
        seen.append("done" if code == 0 else "new" if now == NEW else "old")
        settle(folder)
        assert content(folder) == now and not (folder / STAGE).exists()
        assert (
            not any(p.is_symlink() for p in folder.iterdir())
            and (folder / "mine.txt").read_text() == "mine"
        )
    assert {"old", "new"} <= set(seen) and k > 15


def test_no_room_leaves_everything_as_it_was(tmp_path, monkeypatch):
    replace_files(tmp_path, OLD)

    def full(path, content):
        if path.name == "a.html":
            raise OSError(errno.ENOSPC, "No space left on device")
        path.write_bytes(content)

    monkeypatch.setattr(atomic_files, "_write", full)
    with pytest.raises(
        NotSaved, match=r"a\.html: not written \(No space left on device\): 20 bytes are needed"
    ) as error:
        replace_files(tmp_path, NEW)
    assert (
        error.value.errno == errno.ENOSPC
        and content(tmp_path) == OLD
        and len(list(tmp_path.iterdir())) == 2
    )


def test_without_links(tmp_path, monkeypatch):
    """As on Windows."""

    def refused(*_):
        raise NotImplementedError

    replace_files(tmp_path, OLD)
    monkeypatch.setattr(Path, "symlink_to", refused)
    replace_files(tmp_path, NEW, {"gone"})
    assert content(tmp_path) == NEW and not (tmp_path / STAGE).exists()


def belongs(folder: Path, page: str, result: str) -> bool:
    digest = hashlib.sha256((folder / result).read_bytes()).hexdigest()
    return result_of((folder / page).read_bytes()) == (result, digest)


def undrawn() -> jaxid.Diagnosis:
    """A diagnosis whose page has no pictures, which take seconds."""
    return replace(sample_diagnosis(200), traces=(), missing_force=(), regimes=())


def test_every_page_has_its_json(tmp_path):
    """Also where results of two kinds share a folder; what a stopped run left goes with the whole
    result.
    """
    fit, diagnosis = replace(sample_fit(samples=200), traces=(), history=()), undrawn()
    result_files.save_partial(diagnosis, tmp_path, page=True)
    assert belongs(tmp_path / "partial", "report.html", "diagnosis.json")
    result_files.save_partial(replace(diagnosis, seed=5), tmp_path, page=False)
    assert sorted(content(tmp_path / "partial")) == ["diagnosis.json"]
    (tmp_path / "partial" / "mine.txt").write_text("mine")
    result_files.save(diagnosis, tmp_path)
    assert belongs(tmp_path, "report.html", "diagnosis.json") and not content(tmp_path / "partial")
    result_files.save(fit, tmp_path)
    assert belongs(tmp_path, "report.html", "fit.json") and belongs(
        tmp_path, "diagnosis.html", "diagnosis.json"
    )
    result_files.save(replace(diagnosis, seed=7), tmp_path)
    assert belongs(tmp_path, "report.html", "diagnosis.json") and belongs(
        tmp_path, "fit.html", "fit.json"
    )
    assert sorted(content(tmp_path)) == ["diagnosis.json", "fit.html", "fit.json", "report.html"]
    assert (tmp_path / "partial" / "mine.txt").read_text() == "mine"


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("data") / "small")


@pytest.mark.parametrize("options", [["--quiet"], ["--json"]])
def test_a_full_disk_prints_the_answer(data, tmp_path, monkeypatch, capfd, options):
    """Room for the JSON, none for the page."""
    fit = sample_fit(samples=200)
    monkeypatch.setattr(jaxid, "fit", lambda *_, **__: replace(fit, seed=3))
    result_files.save(fit, tmp_path / "o")
    before = content(tmp_path / "o")

    def work():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
        os._exit(cli.main(["fit", str(data), "--out", str(tmp_path / "o"), *options]))

    assert forked(work) == 1
    told = capfd.readouterr()
    assert (
        str(tmp_path / "o" / "report.html") in told.err
        and "bytes are needed" in told.err
        and "Traceback" not in told.err
    )
    assert json.loads(told.out)["seed"] == 3 if options == ["--json"] else "inertia" in told.out
    assert content(tmp_path / "o") == before and not list(tmp_path.rglob("*.partial"))
    assert json.loads((tmp_path / "o" / "partial" / "fit.json").read_text())["seed"] == 3


STOPPED = """
import sys, time
import jaxid
from jaxid.cli import app as cli
from jaxid.base import interim
from test_results_kept import undrawn

def slow(*_, **__):
    interim.Interim().tell(undrawn())
    print("working", flush=True)
    while DEAF:  # as compiled code: no handler of Python runs
        try:
            time.sleep(60)
        except KeyboardInterrupt:
            time.sleep(60)
    time.sleep(60)

jaxid.diagnose = slow
if DEAF:
    from jaxid.base import stopping
    import threading
    class Deaf(threading.Event().__class__):
        def wait(self, timeout=None):
            return False
    stopping.threading.Event = Deaf
sys.exit(cli.main(["diagnose", sys.argv[1], "--out", sys.argv[2]]))
"""


@pytest.mark.parametrize(
    "name, deaf", [("SIGINT", False), ("SIGTERM", False), ("SIGHUP", False), ("SIGTERM", True)]
)
def test_signals_are_alike(data, tmp_path, name, deaf):
    """What was known is there, the older result too; also where the work does not hear the
    signal.
    """
    result_files.save(replace(undrawn(), seed=9), tmp_path)
    before = content(tmp_path)
    code = STOPPED.replace("DEAF", str(deaf))
    here = [str(Path(__file__).parent), str(Path(__file__).parents[1])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(here)}

    def heard() -> None:
        """A shell has its background jobs ignore SIGINT, and `nohup` SIGHUP: these tests may be
        one.
        """
        for ended in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(ended, signal.SIG_DFL)

    process = subprocess.Popen(
        [sys.executable, "-c", code, str(data), str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        preexec_fn=heard,
    )
    assert process.stdout is not None and process.stdout.readline() == "working\n"
    process.send_signal(getattr(signal, name))
    _, told = process.communicate()  # who sleeps on ends with another code
    assert process.returncode == 130, told
    assert (
        f"what was finished is in {tmp_path / 'partial' / 'diagnosis.json'}" in told
        and "Traceback" not in told
    )
    assert content(tmp_path) == before
    assert json.loads((tmp_path / "partial" / "diagnosis.json").read_text())["seed"] == 0
    page = tmp_path / "partial" / "report.html"  # where there was time for it
    assert not page.exists() or belongs(page.parent, page.name, "diagnosis.json")


COMPILED = """
import sys, threading
import jax
import jaxid
from jaxid.cli import app as cli
from jaxid.base import interim
from test_results_kept import undrawn

endless = jax.jit(lambda x: jax.lax.while_loop(lambda x: x > 0, lambda x: x + 1e-9, x))

def slow(*_, **__):
    interim.Interim().tell(undrawn())
    threading.Thread(target=lambda: endless(1.0).block_until_ready()).start()  # which an interpreter waits for
    print("working", flush=True)
    endless(2.0).block_until_ready()

jaxid.diagnose = slow
cli.run()
"""


def test_compiled_work_ends_in_time(data, tmp_path):
    """Ctrl-C where neither the main thread nor another one comes back to Python: 2 s, with room for
    a busy machine.
    """
    here = [str(Path(__file__).parent), str(Path(__file__).parents[1])]
    process = subprocess.Popen(
        [sys.executable, "-c", COMPILED, "diagnose", str(data), "--out", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(here)},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stdout is not None and process.stdout.readline() == "working\n"
    time.sleep(1.0)  # by now it computes
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=60)
    took = time.monotonic() - began
    assert process.returncode == 130, told
    assert f"what was finished is in {tmp_path / 'partial' / 'diagnosis.json'}" in told
    assert took < 5.0, took


def test_what_is_known_is_told_while_work_goes_on(data):
    """WHERE and the nominal fit, before effects are compared."""
    told = []
    with interim.listening(told.append):
        jaxid.diagnose(None, jaxid.load_dataset(data), effects=["dead_zone"], max_effects=1)
    assert told and isinstance(told[0], jaxid.Diagnosis)
    assert told[0].which.verdict == "unknown" and "Stopped before" in told[0].which.text
    assert told[0].where and set(told[0].nominal.parameters) == {
        "inertia",
        "viscous",
        "coulomb",
        "offset",
    }


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["diagnose", "--effects", "payload"], "joint cannot take payload"),
        (
            ["diagnose", "--effects", "dead_zone", "--residual", "inverse_dynamics"],
            "cannot see dead_zone. Candidates are: ",
        ),
        (
            ["diagnose", "--effects", "coulomb_friction"],
            "coulomb_friction is part of joint already",
        ),
        (["diagnose", "--without", "dead_zone"], "joint has no dead_zone to leave out"),
        (["fit", "--effect", "payload"], "payload has no place in joint, which can take: "),
        (["fit", "--effect", "coulomb_friction"], "coulomb_friction is part of joint already"),
    ],
)
def test_what_is_asked_for_is_done_or_refused(data, tmp_path, capsys, options, words):
    assert cli.main([*options, str(data), "--out", str(tmp_path)]) == 2
    assert words in capsys.readouterr().err


def test_a_model_without_free_numbers_is_diagnosed(tmp_path, recwarn):
    """By torque, where nothing at all is fitted before effects are compared."""
    folder = write_dataset(tmp_path / "small")
    text = (folder / "dataset.toml").read_text()
    stated = "[model.constants]\ninertia = 0.1\nviscous = 0.4\ncoulomb = 0.0\noffset = 0.0\n"
    (folder / "dataset.toml").write_text(text.replace("[channels.tau]", f"{stated}[channels.tau]"))
    found = jaxid.diagnose(
        None, jaxid.load_dataset(folder), effects=["stribeck_friction"], residual="inverse_dynamics"
    )
    assert (
        not found.nominal.parameters
        and found.where
        and found.how_far.gap_after <= found.how_far.gap_before
    )


def test_files_without_end_are_refused(data, tmp_path, capsys):
    large = tmp_path / "large.json"
    with large.open("wb") as stream:
        stream.truncate(LARGEST_BYTES + 1)
    for given in ("/dev/zero", large):
        began = time.monotonic()
        assert (
            cli.main(
                ["simulate", str(data), "--parameters", str(given), "--out", str(tmp_path / "o")]
            )
            == 2
        )
        assert "larger than 16 MiB" in capsys.readouterr().err and time.monotonic() - began < 30
