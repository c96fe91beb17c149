"""Traced programs kept on disk beside the compiled ones.

The compilation cache saves compiling, not tracing: a chain with all its effects takes a second to
trace in every new process, and a fifth of that to read back. Kept is what `jax.export` serialises.
A program is found again by all that its trace depends on: sources of this package (by size and
time), structure, constants, shapes and versions. Where that is not known for sure, as with a model
of the user's own, the program is traced as ever.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from jaxid.numerics.pool import default_platform
from jaxid.numerics.program_cache import CacheFolder, TRACED


class ExportedFunction:
    """A jitted function of arrays (and pytrees of them); its trace is kept under `key` (None: is
    not kept).
    """

    def __init__(self, function: Callable[..., Any], key: str | None):
        self._plain, self._key = jax.jit(function), key
        self._calls: dict[Any, Callable[..., Any]] = {}

    def __call__(self, *args: Any) -> Any:
        leaves, tree = jax.tree.flatten(args)
        call = self._calls.get(kind := _kind(leaves, tree))
        if call is None:
            name = self._name(kind)
            if name is None:
                return self._plain(*args)
            call = self._calls[kind] = self._read_or_trace(name, leaves, tree, kind)
        return call(*leaves)

    def kept(self, *args: Any) -> bool:
        """Whether the trace for such arguments lies on disk."""
        leaves, tree = jax.tree.flatten(args)
        name = self._name(_kind(leaves, tree))
        return name is not None and _folder().has(name)

    def _name(self, kind: Any) -> str | None:
        """What the trace for a kind of arguments is called; None where it is not kept."""
        place = jax.config.values["jax_compilation_cache_dir"]
        if not self._key or not place or "://" in place:
            return None
        return hashlib.sha256(f"{self._key}{kind}".encode()).hexdigest() + ".stablehlo"

    def _read_or_trace(
        self, name: str, leaves: list[Any], tree: Any, kind: Any
    ) -> Callable[..., Any]:
        def plain(*leaves):
            return self._plain(*jax.tree.unflatten(tree, leaves))

        folder = _folder()
        try:
            from jax import export

            kept = folder.read(name)
            if kept is None:
                on = None if (platform := kind[-1]) == jax.default_backend() else [platform]
                kept = bytes(export.export(jax.jit(plain), platforms=on)(*leaves).serialize())
                folder.write(name, kept)
            read = jax.jit(export.deserialize(bytearray(kept)).call)
        except (
            Exception
        ):  # no flatbuffers, an operation or a file that cannot be read back: nothing is lost
            return plain

        def first(*leaves: Any) -> Any:
            """Only the first call shows whether this JAX can compile what it read."""
            try:
                out = read(*leaves)
                self._calls[kind] = read
            except Exception:
                out = plain(*leaves)
                self._calls[kind] = plain
                folder.remove(name)
            return out

        return first


def _folder() -> CacheFolder:
    return CacheFolder(Path(jax.config.values["jax_compilation_cache_dir"]) / TRACED)


def _kind(leaves: Sequence[Any], tree: Any) -> tuple:
    """What a trace is kept by: structure and shapes of its arguments, and what it is to run on,
    which an export is bound to.
    """
    return (
        tree,
        tuple((np.shape(a), getattr(a, "dtype", type(a))) for a in leaves),
        _platform(leaves),
    )


def _platform(leaves: Sequence[Any]) -> str:
    """Where JAX runs a program with such arguments: where they were put on purpose, or on the
    default device.
    """
    platforms: set[str] = set()
    for leaf in leaves:
        if isinstance(leaf, jax.Array) and not isinstance(leaf, Tracer) and leaf.committed:
            platforms |= {device.platform for device in leaf.devices()}
    return ", ".join(sorted(platforms or {default_platform()}))


def key_of(function: Callable[..., Any], pytree: Any, *more: Any) -> str | None:
    """All that a program of a module's function and of a pytree of modules depends on, but for what
    it is called with.

    None where it cannot be told: code from outside of this package (it may depend on any other
    file), closures, static fields without a text that lasts.
    """
    modules = {function.__module__, *(type(part).__module__ for part in _parts(pytree))}
    plain = getattr(sys.modules.get(function.__module__), function.__name__, None) is function
    if not plain or any(m.split(".")[0] != "jaxid" for m in modules):
        return None
    constants = [f"{np.shape(a)} {np.asarray(a).tobytes().hex()}" for a in jax.tree.leaves(pytree)]
    told = "\n".join(
        [
            repr(jax.tree.structure(pytree)),
            *sorted(modules),
            function.__qualname__,
            *map(repr, more),
            *constants,
        ]
    )
    lasting = (
        " at 0x" not in told and "..." not in told
    )  # addresses, and arrays that are not printed in full
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
    found = []
    for package in (
        "jaxid",
        "jaxid.models",
        "jaxid.fitters",
    ):  # of a checkout the last two lie beside the first
        spec = find_spec(package)
        for file in sorted(Path((spec and spec.origin) or "").parent.rglob("*.py")):
            status = file.stat()
            found.append(f"{file.name} {status.st_size} {status.st_mtime_ns}")
    return hashlib.sha256("\n".join(found).encode()).hexdigest()
