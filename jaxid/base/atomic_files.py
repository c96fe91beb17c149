"""Files that belong together take the place of older ones all at once: whoever opens the folder, at
any moment and after any end of this process, finds the old files or the new ones, never some of
each.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from jaxid.base.errors import NotSaved


#: Hidden folder that holds old and new files while they are exchanged, and what in it is read.
STAGE, CURRENT = ".jaxid-exchange", "current"


def replace_files(
    folder: str | Path, files: Mapping[str, bytes], obsolete: Collection[str] = ()
) -> Path:
    """Writes `files` (name -> content) into `folder`, made if missing, and removes the `obsolete`
    ones there, as one act; returns the folder. No other file in it is touched.

    A rename exchanges one file alone. For several, old and new ones are laid side by side into a
    hidden folder, the names become links that lead into it through one more link, and renaming that
    one is the exchange (as Kubernetes' atomic writer does it); at last the links become plain files
    again. Where a process ends on the way, the links go on showing the old or the new files until
    `settle`. A file system without links, as on Windows, exchanges one file after the other.

    Raises `NotSaved`, with the path, the reason and the bytes that are needed; the older files are
    then as they were.
    """
    folder = Path(folder)
    stage = folder / STAGE
    writing = folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _locked(folder):
            _settle(folder)
            try:
                (stage / "new").mkdir(parents=True)
                for name, content in files.items():
                    writing = folder / name
                    _write(stage / "new" / name, content)
                writing = folder
                names = [
                    *files,
                    *(n for n in obsolete if n not in files and os.path.lexists(folder / n)),
                ]
                if len(names) == 1 and files:
                    (stage / "new" / names[0]).replace(folder / names[0])
                else:
                    _exchange(folder, names)
            finally:
                with suppress(OSError):  # the links show what is right, too
                    _settle(folder)
    except OSError as error:
        needed = sum(map(len, files.values()))
        raise NotSaved(
            error.errno, error.strerror or str(error), str(writing), needed, _free(folder)
        ) from error
    return folder


def settle(folder: str | Path) -> None:
    """Ends an exchange that was cut off: its links become the files they show. Does nothing where
    there is none.
    """
    folder = Path(folder)
    if os.path.lexists(folder / STAGE):
        with suppress(OSError), _locked(folder):
            _settle(folder)


def _exchange(folder: Path, names: list[str]) -> None:
    stage = folder / STAGE
    (stage / "old").mkdir()
    for name in names:
        if (folder / name).is_file():
            _keep(folder / name, stage / "old" / name)
    try:
        (stage / CURRENT).symlink_to("old")
    except (OSError, NotImplementedError) as error:
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise
        for name in names:  # no links here
            if (stage / "new" / name).exists():
                (stage / "new" / name).replace(folder / name)
            else:
                (folder / name).unlink(missing_ok=True)
        return
    for name in names:
        link = stage / f"link to {name}"
        link.symlink_to(f"{STAGE}/{CURRENT}/{name}")
        link.replace(folder / name)
    (stage / "next").symlink_to("new")
    (stage / "next").replace(stage / CURRENT)  # the exchange


def _settle(folder: Path) -> None:
    stage = folder / STAGE
    if not os.path.lexists(stage):
        return
    for entry in list(os.scandir(folder)):
        if entry.is_symlink() and os.readlink(entry.path).startswith(f"{STAGE}/{CURRENT}/"):
            shown = stage / Path(os.readlink(stage / CURRENT)).name / entry.name
            if shown.exists():
                shown.replace(entry.path)
            else:
                os.unlink(entry.path)
    shutil.rmtree(stage)


def _write(path: Path, content: bytes) -> None:
    with path.open("xb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())  # a full disk may tell only now


def _keep(path: Path, other: Path) -> None:
    """The file under another name as well."""
    try:
        os.link(path, other)
    except OSError:
        shutil.copy2(path, other)


def _free(folder: Path) -> int | None:
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return None


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """One process at a time, where the system has such locks; the end of a process opens its
    lock.
    """
    try:
        import fcntl

        handle = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):
        yield
        return
    try:
        with suppress(OSError):  # some network file systems
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)
