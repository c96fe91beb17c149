"""Random bit flips over the whole cache of programs: every answer has to be the right one.

    python benchmarks/run_all.py reliability_cache

After each flip a fit is made in a process of its own, which reads every program from the cache:
forked from one that has imported what a fit imports and computed nothing. One flip in 25 is
followed by the command `jaxid fit` in a fresh process instead. `JAXID_RELIABILITY=0.1` runs a tenth
of the counts.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import random
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np


HERE = Path(__file__).resolve().parent
SHARE = float(os.environ.get("JAXID_RELIABILITY", "1"))
FLIPS, COMMAND_EVERY, PROCESSES = 1000, 25, 2
TOLERANCE, BUDGET = 1e-9, 40
ENDS = ("right", "wrong", "errors", "crashes")
TEXT = (
    "One bit is flipped at a random place of the cache of a fit (traced and compiled programs, each bit as likely as any other), "
    "then the fit is made again in a process of its own: after one flip in 25 by the command, else by `jaxid.fit` in a process "
    "forked from one that has computed nothing. Right is an answer whose parameters are all within 1e-9, relatively, of those "
    "with an untouched cache; an error is any other exit code than 0, a crash an end by a signal. Each row says what the flips "
    "hit; what was not made anew is a program that this fit does not read where the others are there."
)
Answer = list[float]


def main() -> dict:
    """Two processes, each with a cache of its own and every other flip."""
    with tempfile.TemporaryDirectory() as folder:
        started = []
        for seed in range(PROCESSES):
            home = Path(folder, str(seed))
            home.mkdir()
            own = {
                "JAXID_CACHE_DIR": f"{home}/cache",
                "PYTHONPATH": f"{HERE.parent}{os.pathsep}{HERE.parent / 'tests'}",
            }
            given = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"} | own
            count = max(1, round(SHARE * FLIPS / PROCESSES))
            started.append(
                (
                    home,
                    subprocess.Popen(
                        [sys.executable, __file__, str(home), str(count), str(seed)], env=given
                    ),
                )
            )
        assert all(process.wait() == 0 for _, process in started)
        found = [json.loads((home / "counts.json").read_text()) for home, _ in started]
    counts: dict[str, Counter] = {}
    for part in found:
        for key, count in part["counts"].items():
            counts.setdefault(key, Counter()).update(count)
    counts = {
        f"all, over {found[0]['cache']}|": sum(counts.values(), Counter()),
        **dict(sorted(counts.items())),
    }
    columns = ("flips", *ENDS, "made anew")
    rows = [
        dict(zip(("hit", "asked by"), key.split("|"), strict=True)) | {c: n[c] for c in columns}
        for key, n in counts.items()
    ]
    return {"title": "Flipped bits in the cache of programs", "text": TEXT, "rows": rows}


def flip(cache: Path, rng: random.Random) -> tuple[Path, bytes, str]:
    """Flips one bit, each of the cache as likely as any other; the file, its content now and what
    was hit.
    """
    from jaxid.numerics.program_cache import HASH_BYTES, MARK

    files = sorted(p for p in cache.rglob("*") if p.is_file())
    file = rng.choices(files, [p.stat().st_size for p in files])[0]
    content = bytearray(file.read_bytes())
    at = rng.randrange(len(content))
    content[at] ^= 1 << rng.randrange(8)
    file.write_bytes(content)
    return (
        file,
        bytes(content),
        f"{file.parent.name} program{', its hash' if at < len(MARK) + HASH_BYTES else ''}",
    )


def by_fork(data: Path, out: Path) -> int:
    """Exit code of a fit in a process of its own; its parameters are in `out`."""
    sys.stdout.flush()
    if pid := os.fork():
        return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    code = 99
    with contextlib.suppress(BaseException):
        import jaxid

        os.dup2(os.open(out / "said", os.O_WRONLY | os.O_CREAT | os.O_APPEND), 2)
        found = jaxid.fit(None, jaxid.load_dataset(data), budget=BUDGET)
        (out / "answer.json").write_text(json.dumps([p.value for p in found.parameters.values()]))
        (out / "modules.json").write_text(
            json.dumps([m for m in sys.modules if m.split(".")[0] != "__main__"])
        )
        code = 0
    os._exit(code)


def by_command(data: Path, out: Path) -> int:
    """The same by the command."""
    command = [
        sys.executable,
        "-m",
        "jaxid.cli",
        "fit",
        str(data),
        "--out",
        str(out),
        "--quiet",
        "--budget",
        str(BUDGET),
    ]
    done = subprocess.run(command, capture_output=True, text=True, cwd=HERE.parent, check=False)
    if done.returncode == 0:
        values = [
            p["value"] for p in json.loads((out / "fit.json").read_text())["parameters"].values()
        ]
        (out / "answer.json").write_text(json.dumps(values))
    return done.returncode


def kind_of(code: int, out: Path, right: Answer) -> str:
    if code:
        return "crashes" if code < 0 else "errors"
    found = json.loads((out / "answer.json").read_text())
    return "right" if np.allclose(found, right, rtol=TOLERANCE, atol=0) else "wrong"


def counted(home: Path, flips: int, seed: int) -> dict:
    """What came of so many flips, by what they hit and how the fit was asked for."""
    from jaxid import runtime
    from tests.test_batch import write_dataset

    runtime.prepare()
    cache, out, data = home / "cache", home / "out", write_dataset(home / "small")
    out.mkdir()
    assert by_command(data, out) == 0 and by_fork(data, out) == 0
    for name in json.loads((out / "modules.json").read_text()):
        with contextlib.suppress(Exception):  # a part of another module that is imported with it
            importlib.import_module(name)
    right: Answer = json.loads((out / "answer.json").read_text())
    files = [p.stat().st_size for p in cache.rglob("*") if p.is_file()]
    rng, counts = random.Random(31 + seed), {}
    for k in range(flips):
        way, asked = (
            (by_command, "`jaxid fit`")
            if k % COMMAND_EVERY == COMMAND_EVERY - 1
            else (by_fork, "`jaxid.fit`")
        )
        file, flipped, hit = flip(cache, rng)
        (out / "answer.json").unlink(missing_ok=True)
        kind = kind_of(way(data, out), out, right)
        mended = file.exists() and file.read_bytes() != flipped
        counts.setdefault(f"{hit}|{asked}", Counter()).update(
            {"flips": 1, kind: 1, "made anew": int(mended)}
        )
        if k % 50 == 49 or kind != "right":
            print(k + 1, kind, {key: dict(n) for key, n in counts.items()}, flush=True)
    return {"cache": f"{len(files)} files of {sum(files) / 1e6:.2f} MB", "counts": counts}


if __name__ == "__main__":
    place = Path(sys.argv[1])
    (place / "counts.json").write_text(
        json.dumps(counted(place, int(sys.argv[2]), int(sys.argv[3])))
    )
