"""A process that was forked after JAX had computed says so instead of waiting for ever."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from test_batch import write_dataset


CODE = """
import multiprocessing as mp, sys, warnings; warnings.simplefilter("ignore")
import jaxid
from jaxid.runtime import prepare
prepare()
data = jaxid.load_dataset("small")
def child(queue):
    try: queue.put(jaxid.fit(None, data, budget=100).loss)
    except BaseException as error: queue.put(f"{type(error).__name__}: {error}")
def answer(kind):
    context = mp.get_context(kind)
    queue = context.Queue()
    process = context.Process(target=child, args=(queue,))
    process.start()
    try: return queue.get(timeout=100)
    finally: process.kill()
before = sys.argv[1]
if before == "fit": jaxid.fit(None, data, budget=3)
if before == "jax":
    import jax.numpy
    jax.numpy.ones(3) + 1
print(answer("fork"))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("before", ["fit", "jax", "nothing"])
def test_a_fit_in_a_forked_process(tmp_path, before):
    write_dataset(tmp_path / "small")
    done = subprocess.run(
        [sys.executable, "-c", CODE, before],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    if before == "nothing":
        assert float(done.stdout) > 0
    else:
        assert (
            done.stdout.startswith("UsageError")
            and "use spawn" in done.stdout
            and "jaxid batch" in done.stdout
        )
