"""The folder of traced and compiled programs: nothing that was damaged, half written or put there
by others is ever read.

A file begins with the hash of its name and content, and is exchanged in one step, so that several
processes may write it and be killed meanwhile. What does not match its hash is removed before
anybody reads it, and made anew.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import stat
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from jaxid.base.wording import complain


#: When a program is written, those are removed that nobody read for so long (s), and what a killed
#: process left half written.
UNUSED_S, HALF_WRITTEN_S = 60 * 24 * 3600.0, 24 * 3600.0
#: What a file begins with, before the hash.
MARK = b"jaxid program 1\n"
HASH_BYTES = 32
HALF_WRITTEN = ".part-"
#: Folders of the programs as traced, and as JAX compiled them.
TRACED, COMPILED = "traced", "compiled"

_LOCK = threading.Lock()


class CacheFolder:
    """Contents by name, in a folder that only this user can enter (0700)."""

    def __init__(self, path: Path):
        self.path, self._swept = path, False

    def has(self, name: str) -> bool:
        return (self.path / name).exists()

    def read(self, name: str) -> bytes | None:
        """The content as it was written; None where there is none."""
        file = self.path / name
        if not _is_own_folder(self.path):
            return None
        try:
            status = file.lstat()
        except OSError:
            return None
        head = MARK + bytes(HASH_BYTES)
        if stat.S_ISREG(status.st_mode) and _is_own(status) and status.st_size > len(head):
            with contextlib.suppress(OSError):
                whole = file.read_bytes()
                content = whole[len(head) :]
                if whole[: len(head)] == MARK + _hash(name, content):
                    with contextlib.suppress(OSError):
                        os.utime(file)
                    return content
        self.remove(name)
        return None

    def remove(self, name: str) -> None:
        """Removes a program that cannot be used, and says so once."""
        file = self.path / name
        try:
            if file.is_dir() and not file.is_symlink():
                shutil.rmtree(file)
            else:
                file.unlink(missing_ok=True)
            _say_once(
                "damaged", f"a damaged program was removed from the cache and is made anew ({file})"
            )
        except OSError as error:
            _say_once(
                "damaged",
                f"a damaged program in the cache is not used ({file}), nor can it be removed:"
                f" {error.strerror}",
            )

    def write(self, name: str, content: bytes) -> None:
        """All of it or nothing, also where several processes write it at once; nothing where the
        disk takes no more.
        """
        with contextlib.suppress(OSError):
            self.path.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not _is_own_folder(self.path):
                return
            part = tempfile.NamedTemporaryFile(dir=self.path, prefix=HALF_WRITTEN, delete=False)
            try:
                with part:
                    part.write(MARK + _hash(name, content) + content)
                os.replace(part.name, self.path / name)
            except BaseException:
                os.unlink(part.name)
                raise
            if not self._swept:
                self._swept = True
                self._sweep()

    def _sweep(self) -> None:
        """Makes room where old ones lie."""
        for old in self.path.iterdir():
            with contextlib.suppress(OSError):
                age = time.time() - old.lstat().st_mtime
                if age > (HALF_WRITTEN_S if old.name.startswith(HALF_WRITTEN) else UNUSED_S):
                    old.unlink()


def _hash(name: str, content: bytes) -> bytes:
    return hashlib.blake2b(name.encode() + b"\0" + content, digest_size=HASH_BYTES).digest()


_SAID: set[str] = set()


def _say_once(kind: str, message: str) -> None:
    """One line a process, however many programs it concerns."""
    with _LOCK:
        said = kind in _SAID
        _SAID.add(kind)
    if not said:
        complain(message)


# ---- whose folder it is


def own_folder(path: Path) -> Path | None:
    """The folder in which the folders of programs lie, made if missing; None where it cannot be
    written or is another user's.

    One that holds other things too keeps its permissions: the folders in it are private anyway.
    """
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        other = any(
            not (entry.name in (TRACED, COMPILED) or entry.name.endswith("-cache"))
            for entry in os.scandir(path)
        )
    except OSError:
        return None
    return path if _is_own_folder(path, close=not other) and os.access(path, os.W_OK) else None


def _is_own_folder(path: Path, close: bool = True) -> bool:
    """Whether a folder is this user's; `close`: has it closed to all others. Says what to type
    where it is another user's.
    """
    try:
        status = path.stat()
        if not _is_own(status):
            _say_once(
                "foreign",
                f"the cache folder {path} belongs to {_owner(status)} and is not used: a program"
                " from it would run as you. Type `export JAXID_CACHE_DIR=~/.cache/jaxid_own` (any"
                " folder of your own), or make it yours with `chown`",
            )
            return False
        if close and hasattr(os, "geteuid") and stat.S_IMODE(status.st_mode) & 0o077:
            path.chmod(0o700)
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode)


def _is_own(status: os.stat_result) -> bool:
    return not hasattr(os, "geteuid") or status.st_uid == os.geteuid()


def _owner(status: os.stat_result) -> str:
    try:
        import pwd

        return f"the user {pwd.getpwuid(status.st_uid).pw_name}"
    except (ImportError, KeyError):
        return f"the user number {status.st_uid}"


# ---- JAX's compiled programs

_wanted: Path | None = None  # the folder that `runtime.prepare` chose


class _Compiled:
    """What JAX takes for its persistent cache of compiled programs (`get` and `put` of bytes under
    a key).
    """

    def __init__(self, folder: Path):
        self._path, self._folder = folder, CacheFolder(folder / COMPILED)

    def get(self, key: str) -> bytes | None:
        return self._folder.read(f"{key}-cache")

    def put(self, key: str, value: bytes) -> None:
        self._folder.write(f"{key}-cache", value)


def want(folder: Path) -> None:
    """Compiled programs are to be kept there, as soon as JAX is there."""
    global _wanted
    _wanted = folder


def keep_compiled() -> None:
    """Has JAX read and write its compiled programs by way of `CacheFolder` where a folder is
    wanted.

    JAX has no public place for that. Where a version of it has none at all, compiled programs are
    not kept: its own cache would read whatever lies there.
    """
    global _wanted
    if _wanted is None:
        return
    with _LOCK:
        folder, _wanted = _wanted, None
    if folder is None:
        return
    import jax

    place = jax.config.values["jax_compilation_cache_dir"] or str(
        folder
    )  # what the user's program has set wins
    if "://" in place:
        return  # a store on the network that is JAX's own business
    taken = _take_over()
    jax.config.update("jax_compilation_cache_dir", place if taken else None)
    if not taken:
        _say_once(
            "version",
            f"JAX {jax.__version__} has no place to check its cache at: every start compiles anew",
        )


def _take_over() -> bool:
    """Whether JAX's cache was exchanged for ours."""
    try:
        from jax._src import compilation_cache
    except ImportError:
        return False
    if not callable(getattr(compilation_cache, "get_file_cache", None)) or not hasattr(
        compilation_cache, "reset_cache"
    ):
        return False

    def checked(path: Any, *_: Any, **__: Any) -> tuple[_Compiled, Any]:
        return _Compiled(Path(path)), path

    compilation_cache.get_file_cache = checked
    compilation_cache.reset_cache()
    return True
