"""Random bit flips over the whole cache of programs: every answer has to be the right one.

    python benchmarks/run_all.py reliability_cache

A share of the flips is followed by a whole `jaxid fit`, in a process of its own. The others are followed by four small programs
in a process that first forgets all it has compiled, so that it reads each of them from the cache again, the way a fit does.
`JAXID_RELIABILITY=0.1` runs a tenth of the counts.
"""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np


HERE = Path(__file__).resolve().parent
SHARE = float(os.environ.get("JAXID_RELIABILITY", "1"))
COMMANDS, CALLS, CALLS_A_PROCESS = 60, 940, 94
TOLERANCE = 1e-9
TEXT = (
    "One bit is flipped at a random place of the whole cache (traced and compiled programs, each bit as likely as any other), "
    "then the programs are used. Right is an answer within 1e-9, relatively, of that with an untouched cache. Each damaged "
    "program was removed and made anew; the others are files that this answer does not need."
)


def main() -> dict:
    with ThreadPoolExecutor() as pool:
        rows = list(pool.map(measured, ("`jaxid fit`, whole commands", "programs in one process"), (commands, calls)))
    return {"title": "Flipped bits in the cache of programs", "text": TEXT, "rows": rows}


def measured(what: str, check: Callable[[Path], dict]) -> dict:
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        row = {"what": what, **check(Path(folder)), "seconds": round(time.perf_counter() - began)}
    print(row, flush=True)
    return row


def flip(cache: Path, rng: random.Random) -> tuple[Path, bytes]:
    """Flips one bit, each of the cache as likely as any other; the file and its content now."""
    files = sorted(p for p in cache.rglob("*") if p.is_file())
    file = rng.choices(files, [p.stat().st_size for p in files])[0]
    content = bytearray(file.read_bytes())
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    file.write_bytes(content)
    return file, bytes(content)


def mended(file: Path, flipped: bytes) -> bool:
    return file.exists() and file.read_bytes() != flipped


def row(count: Counter, cache: Path) -> dict:
    files = [p.stat().st_size for p in cache.rglob("*") if p.is_file()]
    keys = ("right", "wrong", "errors", "crashes", "made anew")
    return {"flips": count["flips"]} | {k: count[k] for k in keys} | {"files": len(files), "size": f"{sum(files) / 1e6:.2f} MB"}


def environment(cache: Path) -> dict[str, str]:
    left = {k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"}
    return left | {"JAXID_CACHE_DIR": str(cache)}


def commands(home: Path) -> dict:
    """One `jaxid fit` after each flip."""
    from tests.test_batch import write_dataset

    cache, out, data = home / "cache", home / "out", write_dataset(home / "small")
    command = [sys.executable, "-m", "jaxid.cli", "fit", str(data), "--out", str(out), "--quiet", "--budget", "40"]
    fit = lambda: subprocess.run(command, env=environment(cache), capture_output=True, text=True, cwd=HERE.parent, check=False)
    answer = lambda: [p["value"] for p in json.loads((out / "fit.json").read_text())["parameters"].values()]
    assert fit().returncode == 0
    expected, rng, count = answer(), random.Random(31), Counter()
    for _ in range(max(2, round(SHARE * COMMANDS))):
        file, flipped = flip(cache, rng)
        (out / "fit.json").unlink(missing_ok=True)
        done = fit()
        right = done.returncode == 0 and np.allclose(answer(), expected, rtol=TOLERANCE, atol=0)
        kind = "right" if right else "crashes" if done.returncode < 0 else "errors" if done.returncode else "wrong"
        count.update({"flips": 1, kind: 1, "made anew": int(mended(file, flipped))})
        print(dict(count), flush=True)
    return row(count, cache)


def calls(home: Path) -> dict:
    """Many flips a process; one that dies is counted and its remaining flips are made by another."""
    cache, count = home / "cache", Counter()
    wanted = max(2, round(SHARE * CALLS))
    worker = lambda *more: subprocess.Popen(
        [sys.executable, __file__, "worker", str(cache), *map(str, more)],
        env=environment(cache) | {"PYTHONPATH": str(HERE.parent)},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    expected = home / "expected.npy"
    assert worker(expected, 0, 0).wait() == 0
    while count["flips"] < wanted:
        process = worker(expected, count["flips"], min(CALLS_A_PROCESS, wanted - count["flips"]))
        assert process.stdout is not None
        begun = ended = 0
        for line in process.stdout:
            told = json.loads(line)
            begun, ended = begun + ("begin" in told), ended + ("begin" not in told)
            count.update({k: v for k, v in told.items() if k != "begin"})
        process.wait()
        print(dict(count), flush=True)
        if begun > ended:
            count.update({"flips": 1, "crashes": 1})
    return row(count, cache)


def worker(cache: Path, expected: Path, seed: int, flips: int) -> None:
    """Writes the expected answer, or tells of each flip what came of it."""
    from jaxid.runtime import prepare

    prepare()
    import jax

    from jaxid.numerics.export_cache import Traced
    from jaxid.numerics.precision import float64

    def answer() -> np.ndarray:
        """What four programs say that were just read from the cache, as the programs of a fit are."""
        jax.clear_caches()
        with float64():
            told = [Traced(f, f"{f.__name__} of this benchmark")(X) for f in (squares, spread, bent, mixed)]
        return np.concatenate([np.ravel(t) for t in told])

    if not flips:
        np.save(expected, answer())
        return
    right, rng = np.load(expected), random.Random(seed)
    for _ in range(flips):
        file, flipped = flip(cache, rng)
        print(json.dumps({"begin": file.name}), flush=True)
        try:
            kind = "right" if np.allclose(answer(), right, rtol=TOLERANCE, atol=1e-14) else "wrong"
        except Exception:
            kind = "errors"
        print(json.dumps({"flips": 1, kind: 1, "made anew": int(mended(file, flipped))}), flush=True)


X = np.linspace(0.1, 1.3, 40)


def squares(x):
    return (x**2).sum() * x


def spread(x):
    return x[:, None] * x - x.mean()


def bent(x):
    return (x**3 - 0.3 * x) @ x


def mixed(x):
    return x.reshape(8, 5) @ x.reshape(5, 8)


if __name__ == "__main__":
    worker(Path(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[4]), int(sys.argv[5]))
