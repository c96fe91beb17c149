"""The folder of programs: what is read is what was written, whatever happened to the files
meanwhile.
"""

from __future__ import annotations

import os
import random
import signal
import stat
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from jaxid.numerics import program_cache
from jaxid.numerics.program_cache import CacheFolder, own_folder


CONTENT = random.Random(0).randbytes(3000)

# A process that computes through the cache, and tells its result and how often JAX asked the cache.
COMPUTE = """
import jaxid.runtime; jaxid.runtime.prepare()
import jax, numpy as np
from jax import monitoring
from jaxid.numerics.precision import float64
hits = []
monitoring.register_event_listener(lambda event, **_: hits.append(event) if event.endswith("cache_hits") else None)
from jaxid.numerics.export_cache import ExportedFunction
def program(x): return jax.numpy.cumsum(jax.numpy.sin(x) ** 2)
with float64():
    print(np.asarray(ExportedFunction(program, "the key")(np.linspace(0, 9, 50))).tobytes().hex(), len(hits))
"""


@pytest.fixture(autouse=True)
def nothing_said_yet(monkeypatch):
    monkeypatch.setattr(program_cache, "_SAID", set())


def compute(folder: Path, **more: str) -> tuple[str, int, str]:
    """(result, hits of JAX's cache, standard error) of a process with that cache."""
    environment = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    environment |= {"JAXID_CACHE_DIR": str(folder), **more}
    done = subprocess.run(
        [sys.executable, "-c", COMPUTE],
        capture_output=True,
        text=True,
        env=environment,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    result, hits = done.stdout.split()
    return result, int(hits), done.stderr


def files(folder: Path) -> list[Path]:
    return sorted(p for p in folder.rglob("*") if p.is_file())


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_reads_what_was_written(tmp_path):
    folder = CacheFolder(tmp_path / "a" / "b")
    assert folder.read("x") is None and not folder.has("x")
    folder.write("x", CONTENT)
    assert folder.has("x") and CacheFolder(folder.path).read("x") == CONTENT
    folder.write("x", b"anew")
    assert folder.read("x") == b"anew"
    assert [p.name for p in folder.path.iterdir()] == ["x"]


def test_every_flipped_bit_of_a_file_is_found(tmp_path, capsys):
    folder = CacheFolder(tmp_path)
    folder.write("x", CONTENT[:40])
    whole = (tmp_path / "x").read_bytes()
    for k in range(8 * len(whole)):
        damaged = bytearray(whole)
        damaged[k // 8] ^= 1 << k % 8
        (tmp_path / "x").write_bytes(damaged)
        assert folder.read("x") is None and not folder.has("x")
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and str(tmp_path / "x") in said  # one line, however many


def cut(path: Path, whole: bytes) -> None:
    path.write_bytes(whole[:-1])


def made_longer(path: Path, whole: bytes) -> None:
    path.write_bytes(whole + b"\0")


def emptied(path: Path, whole: bytes) -> None:
    path.write_bytes(b"")


def without_hash(path: Path, whole: bytes) -> None:
    path.write_bytes(CONTENT)


def another_program(path: Path, whole: bytes) -> None:
    CacheFolder(path.parent).write("another", b"another program")
    os.replace(path.parent / "another", path)


def link(path: Path, whole: bytes) -> None:
    path.rename(path.parent / "away")
    path.symlink_to("away")


def pipe(path: Path, whole: bytes) -> None:
    path.unlink()
    os.mkfifo(path)


def folder_with_content(path: Path, whole: bytes) -> None:
    path.unlink()
    path.mkdir()
    (path / "x").write_bytes(whole)


DAMAGES = [
    cut,
    made_longer,
    emptied,
    without_hash,
    another_program,
    link,
    pipe,
    folder_with_content,
]


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda f: f.__name__)
def test_whatever_else_lies_there_is_removed_and_made_anew(tmp_path, damage, capsys):
    folder = CacheFolder(tmp_path)
    folder.write("x", CONTENT)
    damage(tmp_path / "x", (tmp_path / "x").read_bytes())
    assert folder.read("x") is None and not os.path.lexists(tmp_path / "x")
    assert "made anew" in capsys.readouterr().err
    folder.write("x", CONTENT)
    assert folder.read("x") == CONTENT


def test_several_write_and_read_at_once(tmp_path):
    contents = [bytes([k]) * 20_000 for k in range(8)]

    def work(k: int) -> None:
        folder = CacheFolder(tmp_path)
        for _ in range(50):
            folder.write("x", contents[k])
            assert folder.read("x") in contents

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(work, range(8)))
    assert [p.name for p in tmp_path.iterdir()] == ["x"]


def test_killed_while_it_writes(tmp_path):
    """What is left behind is either whole or never read; it goes when it is old."""
    code = (
        "import sys; from pathlib import Path; from jaxid.numerics.program_cache import CacheFolder\n"
        "folder = CacheFolder(Path(sys.argv[1])); print(flush=True)\n"
        "while True: [folder.write(f'x{k}', bytes([k]) * 3_000_000) for k in range(4)]"
    )
    for seed in range(5):
        process = subprocess.Popen(
            [sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE
        )
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(random.Random(seed).uniform(0, 0.1))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        folder = CacheFolder(tmp_path)
        for k in range(4):
            assert folder.read(f"x{k}") in (None, bytes([k]) * 3_000_000)
    (tmp_path / ".part-left").write_bytes(b"half")
    for left in tmp_path.glob(".part-*"):
        os.utime(left, (0, 0))
    CacheFolder(tmp_path).write("y", CONTENT)
    assert not list(tmp_path.glob(".part-*"))


def test_programs_that_nobody_reads_go(tmp_path):
    folder = CacheFolder(tmp_path)
    for name in ("old", "used"):
        folder.write(name, CONTENT)
        os.utime(tmp_path / name, (0, 0))
    assert folder.read("used") == CONTENT
    CacheFolder(tmp_path).write("new", CONTENT)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["new", "used"]


def test_a_disk_that_takes_no_more(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    CacheFolder(tmp_path).write("x", CONTENT)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="needs users")
def test_folders_are_private_and_those_of_others_refused(tmp_path, monkeypatch, capsys):
    folder = CacheFolder(tmp_path / "cache" / "traced")
    assert own_folder(tmp_path / "cache") is not None and mode(tmp_path / "cache") == 0o700
    folder.write("x", CONTENT)
    assert mode(folder.path) == 0o700 and mode(folder.path / "x") == 0o600
    for path in (tmp_path / "cache", folder.path):
        path.chmod(0o777)
    assert own_folder(tmp_path / "cache") and folder.read("x") == CONTENT
    assert mode(tmp_path / "cache") == mode(folder.path) == 0o700
    (tmp_path / "cache" / "something else").touch()
    (tmp_path / "cache").chmod(0o755)
    assert (
        own_folder(tmp_path / "cache") and mode(tmp_path / "cache") == 0o755
    )  # holds other things too
    assert capsys.readouterr().err == ""

    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)  # all is another user's now
    assert folder.read("x") is None and own_folder(tmp_path / "cache") is None
    said = capsys.readouterr().err
    assert (
        said.count("\n") == 1 and "export JAXID_CACHE_DIR=" in said and (folder.path / "x").exists()
    )


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give files away"
)
def test_files_of_others(tmp_path):
    folder = CacheFolder(tmp_path)
    folder.write("x", CONTENT)
    os.chown(tmp_path / "x", 12345, 12345)
    assert folder.read("x") is None and not folder.has("x")


def test_jax_reads_nothing_but_checked_programs(tmp_path):
    """Traced and compiled programs alike, in the process that computes."""
    first, hits, _ = compute(tmp_path)
    kept = files(tmp_path)
    assert {p.parent.name for p in kept} == {"traced", "compiled"} and hits == 0
    assert mode(tmp_path) == 0o700 and all(mode(p) == 0o600 for p in kept)
    result, hits, said = compute(tmp_path)
    assert (result, said) == (first, "") and hits >= 1

    contents = {p: p.read_bytes() for p in kept}
    for path in kept:
        damaged = bytearray(contents[path])
        damaged[len(damaged) // 2] ^= 4
        path.write_bytes(damaged)
    (tmp_path / "manifest.json").write_text("{")
    (tmp_path / "compiled" / "extra").write_bytes(b"extra")
    result, hits, said = compute(tmp_path)
    assert (result, hits) == (first, 0)
    assert said.count("\n") == 1 and "made anew" in said
    assert compute(tmp_path)[::2] == (first, "")


def test_a_jax_without_a_place_to_check_keeps_nothing(tmp_path, monkeypatch):
    no_place = "from jax import monitoring; from jax._src import compilation_cache; del compilation_cache.get_file_cache"
    monkeypatch.setitem(
        globals(), "COMPUTE", COMPUTE.replace("from jax import monitoring", no_place)
    )
    _, hits, said = compute(tmp_path)
    assert hits == 0 and said.count("\n") == 1 and "compiles anew" in said and not files(tmp_path)
