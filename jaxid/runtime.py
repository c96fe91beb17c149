"""What a command sets up before JAX is imported. `import jaxid` alone sets none of it."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from jaxid.base.progress import Bar, Callback
from jaxid.base.stopping import Interrupted as Interrupted
from jaxid.base.versions import check_jax
from jaxid.numerics.program_cache import own_folder, want


# XLA on the CPU runs small while loops op by op on one thread; with this limit the loop over
# samples counts as small.
LOOP_FLAG = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000000"
# Programs here are one long loop body: more than LLVM's first level compiles for 1.6 times as long
# and runs no faster (measured).
LEVEL_FLAG = "--xla_backend_optimization_level=1"


def prepare(streaming: bool = False) -> None:
    """Sets XLA's flags, the platform and NumPy's threads by environment variables (values already
    set win), and the cache of programs. Python's garbage collector runs more rarely.

    Call it before JAX is imported. `JAXID_XLA=0` leaves XLA's flags alone; `JAXID_CACHE_DIR` moves
    the cache, as does JAX's own `JAX_COMPILATION_CACHE_DIR`; a cache folder that cannot be written
    is left out silently, one of another user with a line. Raises `UsageError` for a JAX that is too
    old.

    `streaming` is for a program that answers one sample at a time: JAX then dispatches in the
    thread that calls it and keeps one worker besides. Handing a small program from thread to thread
    takes as long as the program; fits, which are large, gain by it.
    """
    check_jax()
    flags = os.environ.get("XLA_FLAGS", "")
    os.environ.setdefault("JAX_PLATFORMS", "cpu")
    if os.environ.get("JAXID_XLA") != "0":
        cpu = os.environ["JAX_PLATFORMS"] == "cpu"  # the level is that of other platforms, too
        wanted = (LOOP_FLAG, LEVEL_FLAG) if cpu else (LOOP_FLAG,)
        ours = [flag for flag in wanted if flag.split("=")[0].lstrip("-") not in flags]
        os.environ["XLA_FLAGS"] = " ".join([*flags.split(), *ours])
    # XLA writes to standard error from beneath Python. A program that compiles long is no error;
    # what fails raises.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    # NumPy's matrices are small here; more threads only wait for each other (measured: 3 to 5 times
    # the CPU time).
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    chosen = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    folder = (
        cache_folder() if not chosen else own_folder(Path(chosen)) if "://" not in chosen else None
    )
    if folder is not None:
        want(folder)
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")
        os.environ.setdefault(
            "JAX_PERSISTENT_CACHE_ENABLE_XLA_CACHES", "none"
        )  # XLA reads those itself, unchecked
    # Tracing a program makes hundreds of thousands of objects that live on; going through them
    # again and again takes a tenth.
    gc.set_threshold(100_000, 50, 50)
    if streaming:
        os.environ.setdefault("PJRT_NPROC", "1")
        import jax  # it does not read this setting from the environment

        jax.config.update("jax_cpu_enable_async_dispatch", False)


@contextmanager
def progress_bar(seconds: float | None = None) -> Iterator[Callback]:
    """A line that says how far long work is, for a script or a notebook: what it yields goes to the
    argument `progress` of `jaxid.fit`, `diagnose`, `compare` and `identify`. `seconds`: the limit
    that the work is given.
    """
    bar = Bar(seconds=seconds)
    try:
        yield bar
    finally:
        bar.stop()


def cache_folder() -> Path | None:
    """The folder of the cache of programs, made if missing; None where it cannot be written or is
    another user's.
    """
    try:
        return own_folder(Path(os.environ.get("JAXID_CACHE_DIR") or _user_cache() / "jaxid"))
    except RuntimeError:  # no home folder
        return None


def _user_cache() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
