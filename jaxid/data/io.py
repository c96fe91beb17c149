"""Reading and writing a dataset: a folder with `dataset.toml` and CSV or Parquet files."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
import tomllib
from itertools import islice
from pathlib import Path
from typing import Any

from jaxid.base.errors import DatasetError, DatasetProblem
from jaxid.base.small_files import read_small
from jaxid.base.wording import names_of
from jaxid.data.capacity import too_large_to_read
from jaxid.data.dataset import Dataset
from jaxid.data.patterns import by_number, expanded_files
from jaxid.data.places import Places
from jaxid.data.reading.assemble import assemble
from jaxid.data.schema import ExperimentEntry, read_document
from jaxid.data.table import read_table, Table


SUFFIXES = (".csv", ".parquet", ".pq")


def load_dataset(path: str | os.PathLike[str], *, check_model: bool = True) -> Dataset:
    """The dataset in a folder (or of a `dataset.toml`), in SI units.

    `check_model=False` reads data without asking whether they fit the model that `dataset.toml`
    names.

    Raises `DatasetError` with every fault of the folder at once, each with file, row, column and
    what to do. Data that deserve a look (long time steps, a constant input) give a `DatasetWarning`
    and a line in `Dataset.notes`.
    """
    folder = Path(path)
    if folder.name == "dataset.toml" and not folder.is_dir():
        folder = folder.parent
    content, text, raw = _description(folder)
    places = Places("dataset.toml", text)
    document = read_document(raw, places)
    document.problems += expanded_files(document, places, folder, SUFFIXES)
    folder_tables = _Folder(folder, places, numbered=by_number(document))
    return assemble(
        document,
        places,
        folder_tables.open,
        check_model=check_model,
        sha256=lambda: folder_tables.sha256(content),
        open_text=folder_tables,
    )


def _refuse(file: str, message: str, remedy: str, row: int | None = None) -> DatasetError:
    return DatasetError([DatasetProblem(file, row, None, message, remedy)])


def _description(folder: Path) -> tuple[bytes, str, dict[str, Any]]:
    file = "dataset.toml"
    try:
        if folder.is_file():
            remedy = (
                f"Import it first: jaxid import SOURCE {folder} --out DIR (jaxid import --help"
                " lists the sources)"
            )
            raise _refuse(str(folder), "this is a file, and a dataset is a folder", remedy)
        if not folder.is_dir():
            raise _refuse(
                str(folder), "there is no such folder", "Name a folder that holds a dataset.toml"
            )
        if not (folder / file).is_file():
            raise _refuse(
                file,
                f"there is no dataset.toml in {folder}",
                "Let `jaxid new DIR FILE…` write it; docs/getting_started.md describes it",
            )
        content = read_small(folder / file)
    except (OSError, ValueError) as error:
        if isinstance(error, DatasetError):
            raise
        raise _refuse(
            file, f"not readable ({error})", "Check the path and its permissions"
        ) from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = content.count(b"\n", 0, error.start) + 1
        raise _refuse(
            file, "a character that is not UTF-8", "Save the file as UTF-8", row
        ) from None
    try:
        return content, text, tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        line = re.search(r"at line (\d+)", str(error))
        message = str(error).split(" (at ")[0].strip().rstrip(".") or type(error).__name__
        row = int(line[1]) if line else None
        stated = (
            text.splitlines()[row - 1] if row is not None and row <= len(text.splitlines()) else ""
        )
        remedy = "Correct the line"
        if "\\" in stated:
            remedy = f"Write forward slashes: {stated.strip().replace(chr(92), '/')}"
        raise _refuse(
            file, f"not readable as TOML: {message[:1].lower()}{message[1:]}", remedy, row
        ) from None


def _leads_away(file: str) -> bool:
    """Whether a name is one of a place outside the folder, on any system."""
    if ".." in re.split(r"[/\\]", file):
        return True
    return Path(file).is_absolute() or file[1:2] == ":" or file[:1] == "\\"


class _Folder:
    """The data files of a folder, each read once."""

    def __init__(self, folder: Path, places: Places, numbered: bool):
        self.folder = folder
        self.numbered = numbered
        self.places = places
        self.tables: dict[str, Table] = {}
        self.digests: dict[str, bytes] = {}

    def open(self, index: int, entry: ExperimentEntry) -> Table | DatasetProblem:
        file = entry.file
        if file in self.tables:
            return self.tables[file]
        content = self._content(file, ("experiments", index, "file"), SUFFIXES)
        if isinstance(content, DatasetProblem):
            return content
        self.tables[file] = read_table(self.folder / file, file, content, numbered=self.numbered)
        return self.tables[file]

    def path(self, file: str) -> Path:
        return self.folder / file

    def __call__(self, file: str, key: tuple[str | int, ...]) -> str | DatasetProblem:
        """A file of the folder as text."""
        suffixes = (".py",) if key == ("model", "file") else (".urdf", ".xml", ".mjcf")
        content = self._content(file, key, suffixes)
        if isinstance(content, DatasetProblem):
            return content
        try:
            return content.decode("utf-8-sig")
        except UnicodeDecodeError:
            return self.places.problem(
                key, f"{file!r} holds a character that is not UTF-8", "Save the file as UTF-8"
            )

    def _content(
        self, file: str, key: tuple[str | int, ...], suffixes: tuple[str, ...]
    ) -> bytes | DatasetProblem:
        kinds = " nor ".join(s for s in suffixes if s != ".pq")
        try:
            path = self.folder / file
            if any(c in file for c in "\a\b\t\n\v\f\r"):
                return self._absent(file, key, suffixes)  # "sub\run.csv" holds a carriage return
            if _leads_away(file) or not path.resolve().is_relative_to(self.folder.resolve()):
                return self.places.problem(
                    key,
                    f"{file!r} lies outside the folder",
                    "Move the file into the dataset's folder",
                )
            if path.is_dir():
                return self.places.problem(
                    key, f"{file!r} is a folder", f"Name a {kinds.replace('nor', 'or')} file"
                )
            if path.suffix.lower() not in suffixes:
                return self.places.problem(
                    key, f"{file!r} is neither {kinds}", f"Name a {kinds.replace('nor', 'or')} file"
                )
            if not path.is_file():
                return self._absent(file, key, suffixes)
            if suffixes is SUFFIXES and (found := too_large_to_read(path)):
                return self.places.problem(key, f"{file!r}: {found[0]}", found[1])
            content = path.read_bytes()
        except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: a circle of links
            reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
            return self.places.problem(
                key, f"{file!r} is not readable ({reason})", "Correct its name or permissions"
            )
        self.digests[file] = hashlib.sha256(content).digest()
        return content

    def _absent(
        self, file: str, key: tuple[str | int, ...], suffixes: tuple[str, ...]
    ) -> DatasetProblem:
        found = (
            p
            for p in sorted(self.folder.rglob("*"))
            if p.suffix.lower() in suffixes and p.is_file()
        )
        there = [p.relative_to(self.folder).as_posix() for p in islice(found, 12)]
        hint = f" (there is: {', '.join(there)})" if there else ""
        remedy = "Add the file or correct its name"
        stated = self.places.line(key)
        if "\\" in stated:
            remedy = f"Write forward slashes: {stated.strip().replace(chr(92), '/')}"
        return self.places.problem(key, f"there is no file {file!r}{hint}", remedy)

    def sha256(self, description: bytes) -> str:
        digest = hashlib.sha256(description)
        for file in sorted(self.digests):
            digest.update(file.encode() + b"\0" + self.digests[file])
        return digest.hexdigest()


def save_dataset(
    dataset: Dataset,
    folder: str | os.PathLike[str],
    *,
    format: str = "parquet",
    overwrite: bool = False,
) -> Path:
    """Writes `dataset.toml` and `run_1.parquet` … (or `.csv`), in SI; `load_dataset` reads an equal
    dataset from it.

    The folder appears complete or not at all. An existing folder with other content is left alone
    unless `overwrite`.

    Raises `DatasetError` where the folder exists, or where it cannot be written.
    """
    from jaxid.data.write import write_files

    if format not in ("parquet", "csv"):
        raise ValueError(f"format is {format!r}; it is 'parquet' or 'csv'")
    target = Path(folder)
    if target.exists() and not target.is_dir():
        raise _refuse(str(target), "a file has this name", "Choose another folder")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    except OSError as error:
        raise _refuse(
            str(target), f"cannot be written ({error.strerror})", "Choose another folder"
        ) from None
    try:
        write_files(dataset, temporary, format)
        if target.exists() and any(target.iterdir()):
            if _same_files(temporary, target):
                return target
            if not overwrite:
                raise _refuse(
                    str(target),
                    "the folder exists and holds other files",
                    "Choose another folder, or say overwrite=True",
                )
        temporary.chmod(0o777 & ~_umask())
        _exchange(temporary, target)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return target


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _exchange(new: Path, target: Path) -> None:
    """Puts `new` in the place of `target`; the old folder goes only when the new one stands."""
    if not target.exists():
        new.rename(target)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{target.name}.old.", dir=target.parent))
    target.rename(old / "content")
    try:
        new.rename(target)
    except OSError:
        (old / "content").rename(target)
        raise
    finally:
        shutil.rmtree(old, ignore_errors=True)


def _same_files(a: Path, b: Path) -> bool:
    names = sorted(names_of(a.iterdir()))
    return names == sorted(names_of(b.iterdir())) and all(
        (b / n).is_file() and (a / n).read_bytes() == (b / n).read_bytes() for n in names
    )
