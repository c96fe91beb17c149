"""Traced programs kept on disk beside the compiled ones.

The compilation cache saves compiling, not tracing: a chain with all its effects takes a second to trace in every new process, and
a fifth of that to read back. Kept is what `jax.export` serialises. A program is found again by all that its trace depends on:
sources of this package (by size and time), structure, constants, shapes and versions. Where that is not known for sure, as with a
model of the user's own, the program is traced as ever.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np


#: A kept program that was not read for so long (s) is removed when another one is written.
UNUSED_S = 60 * 24 * 3600.0


class Traced:
    """A jitted function of arrays (and pytrees of them); its trace is kept under `key` (None: is not kept)."""

    def __init__(self, function: Callable[..., Any], key: str | None):
        self._plain, self._key = jax.jit(function), key
        self._calls: dict[Any, Callable[..., Any]] = {}

    def __call__(self, *args: Any) -> Any:
        leaves, tree = jax.tree.flatten(args)
        call = self._calls.get(kind := (tree, _shapes(leaves)))
        if call is None:
            file = self._file(kind)
            if file is None:
                return self._plain(*args)
            call = self._calls[kind] = self._read_or_trace(file, leaves, tree)
        return call(*leaves)

    def kept(self, *args: Any) -> bool:
        """Whether the trace for such arguments lies on disk."""
        leaves, tree = jax.tree.flatten(args)
        file = self._file((tree, _shapes(leaves)))
        return file is not None and file.exists()

    def _file(self, kind: Any) -> Path | None:
        folder = self._key and jax.config.values["jax_compilation_cache_dir"]
        if not folder:
            return None
        name = hashlib.sha256(f"{self._key}{kind[0]}{kind[1]}{jax.default_backend()}".encode()).hexdigest()
        return Path(folder) / "traced" / f"{name}.stablehlo"

    def _read_or_trace(self, file: Path, leaves: list[Any], tree: Any) -> Callable[..., Any]:
        plain = lambda *leaves: self._plain(*jax.tree.unflatten(tree, leaves))
        try:
            from jax import export

            kept = _read(file)
            if kept is None:
                kept = bytes(export.export(jax.jit(plain))(*leaves).serialize())
                _write(file, kept)
            return jax.jit(export.deserialize(bytearray(kept)).call)
        except Exception:  # no writable folder, no flatbuffers, an operation or a file that cannot be read back: nothing is lost
            return plain


def _shapes(leaves: Sequence[Any]) -> tuple:
    return tuple((np.shape(a), getattr(a, "dtype", type(a))) for a in leaves)


def key_of(function: Callable[..., Any], pytree: Any, *more: Any) -> str | None:
    """All that a program of a module's function and of a pytree of modules depends on, but for what it is called with.

    None where it cannot be told: code from outside of this package (it may depend on any other file), closures, static fields
    without a text that lasts.
    """
    modules = {function.__module__, *(type(part).__module__ for part in _parts(pytree))}
    plain = getattr(sys.modules.get(function.__module__), function.__name__, None) is function
    if not plain or any(m.split(".")[0] != "jaxid" for m in modules):
        return None
    constants = [f"{np.shape(a)} {np.asarray(a).tobytes().hex()}" for a in jax.tree.leaves(pytree)]
    told = "\n".join([repr(jax.tree.structure(pytree)), *sorted(modules), function.__qualname__, *map(repr, more), *constants])
    lasting = " at 0x" not in told and "..." not in told  # addresses, and arrays that are not printed in full
    return f"{told}\n{jax.__version__} {_own_sources()}" if lasting else None


def _parts(pytree: Any) -> Iterator[Any]:
    """The modules of a pytree of modules, whatever they stand in."""
    if isinstance(pytree, eqx.Module):
        yield pytree
        yield from _parts(vars(pytree))
    elif isinstance(pytree, dict):
        yield from _parts(list(pytree.values()))
    elif isinstance(pytree, Sequence) and not isinstance(pytree, str | bytes):
        for part in pytree:
            yield from _parts(part)


@cache
def _own_sources() -> str:
    """Size and time of every source of this package."""
    import jaxid.fitters
    import jaxid.models

    found = []
    for package in (jaxid, jaxid.models, jaxid.fitters):  # of a checkout `__path__` names its root, too
        for file in sorted(Path(package.__file__ or "").parent.rglob("*.py")):
            status = file.stat()
            found.append(f"{file.name} {status.st_size} {status.st_mtime_ns}")
    return hashlib.sha256("\n".join(found).encode()).hexdigest()


def _read(file: Path) -> bytes | None:
    try:
        content = file.read_bytes()
        os.utime(file)
    except OSError:
        return None
    return content or None


def _write(file: Path, content: bytes) -> None:
    """All of it or nothing, also where several processes write it at once; makes room where old ones lie."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=file.parent, delete=False) as part:
        part.write(content)
    os.replace(part.name, file)
    for old in file.parent.glob("*"):
        if time.time() - old.stat().st_mtime > UNUSED_S:
            old.unlink(missing_ok=True)
