"""The store of a study: one SQLite file that survives kills, full disks and flipped bits.

One process writes it, the holder of the lease. A result is acknowledged once its transaction is on
the disk; every row carries a checksum, so that a flipped bit is found and its task computed again.
Histories of searches go into files beside it, which appear whole (rename) before the rows that name
them.
"""

from __future__ import annotations

import io
import os
import sqlite3
import time
import uuid
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxid.base.errors import UsageError
from jaxid.study.lease import alive, machine, process_start
from jaxid.study.rows import COLUMNS, read_damaged, sound, StudyRow


#: "jxid": tells a store from any other SQLite file.
APPLICATION = 0x6A786964
#: Step k brings a store of schema k to schema k + 1; schema 0 is an empty file.
MIGRATIONS: tuple[str, ...] = (
    """
    CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
    CREATE TABLE results (id INTEGER PRIMARY KEY, key TEXT NOT NULL UNIQUE, status TEXT NOT NULL, arrays TEXT NOT NULL,
                          body BLOB NOT NULL, crc INTEGER NOT NULL);
    CREATE TABLE damaged (id INTEGER PRIMARY KEY, found REAL NOT NULL, key BLOB, status BLOB, arrays BLOB, body BLOB, crc BLOB);
    CREATE TABLE lease (id INTEGER PRIMARY KEY CHECK (id = 1), owner TEXT NOT NULL, host TEXT NOT NULL, pid INTEGER NOT NULL,
                        started REAL NOT NULL, renewed REAL NOT NULL, running INTEGER NOT NULL);
    """,
)
SCHEMA = len(MIGRATIONS)
#: How long to wait for another process's transaction.
BUSY_S = 20.0


class StoreError(UsageError):
    """The store cannot be read or written; what is in it is unharmed, and the message says what to
    do.
    """


class NotBegun(StoreError):
    """The file is there, its tables are not yet."""


class LeaseLost(StoreError):
    """Another process has taken the store over."""


class Store:
    """An open store. `writable=False` looks without changing anything."""

    def __init__(self, folder: Path, writable: bool = True):
        self.folder, self.path = folder, folder / "study.sqlite"
        self.writable, self.owner = writable, ""
        self.salvaged: int | None = None  # results saved from a damaged file, if it was
        if writable:
            try:
                folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise StoreError(
                    f"{folder}: cannot be made ({error.strerror}); name another `store`"
                ) from None
        self.db = self._connect()
        try:
            self._check()
        except sqlite3.DatabaseError as error:
            self.db.close()
            if isinstance(error, sqlite3.OperationalError) or not writable:
                raise self._said(error) from None
            self._salvage(error)

    def __enter__(self) -> Store:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def close(self) -> None:
        """Gives the lease back and closes the file."""
        try:
            if self.owner:
                self._write("DELETE FROM lease WHERE owner = ?", (self.owner,))
        except (StoreError, sqlite3.Error):
            pass  # the lease of a dead process counts for nothing
        finally:
            self.owner = ""
            self.db.close()

    # ---- opening

    def _connect(self) -> sqlite3.Connection:
        mode = (
            "rwc"
            if self.writable
            else "rw"
            if os.access(self.path, os.W_OK) and os.access(self.folder, os.W_OK)
            else "ro"
        )
        uri = f"{self.path.resolve().as_uri()}?mode={mode}"
        try:
            db = sqlite3.connect(uri, uri=True, timeout=BUSY_S, isolation_level=None)
            db.execute("PRAGMA trusted_schema = OFF")
        except sqlite3.Error as error:
            raise self._said(error) from None
        return db

    def _check(self) -> None:
        self.db.execute(
            "BEGIN"
        )  # all as it was at one time: another process may be making the tables
        try:
            (found,) = self.db.execute("PRAGMA application_id").fetchone()
            (version,) = self.db.execute("PRAGMA user_version").fetchone()
            tables = self.db.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
        finally:
            if self.db.in_transaction:
                self.db.execute("ROLLBACK")
        if tables and found != APPLICATION:
            raise StoreError(f"{self.path}: is not the store of a study; name another `store`")
        if version > SCHEMA:
            raise StoreError(
                f"{self.path}: was written by a newer jaxid (schema {version}, this one knows"
                f" {SCHEMA}); update jaxid, or name another `store`"
            )
        if self.writable:
            # No shared memory (WAL needs it), so that a store may lie on a network file system;
            # EXTRA also syncs the folder.
            self.db.execute("PRAGMA journal_mode = DELETE")
            self.db.execute("PRAGMA synchronous = EXTRA")
            if version < SCHEMA:
                self._migrate()
        elif not tables:
            raise NotBegun(f"{self.path}: is empty")
        elif version < SCHEMA:
            raise StoreError(
                f"{self.path}: is of an older schema; run the study once to bring it up to date"
            )

    def _migrate(self) -> None:
        with self._transaction():
            (version,) = self.db.execute(
                "PRAGMA user_version"
            ).fetchone()  # another process may have been quicker
            for step in MIGRATIONS[version:]:
                for statement in filter(str.strip, step.split(";")):
                    self.db.execute(statement)
            self.db.execute(f"PRAGMA application_id = {APPLICATION}")
            self.db.execute(f"PRAGMA user_version = {SCHEMA}")

    def _salvage(self, reason: object) -> None:
        """Puts a file whose structure is damaged aside and starts a new one with every row that can
        still be read.
        """
        aside = next(
            p
            for n in range(1, 10_000)
            if not (p := self.folder / f"study.sqlite.damaged-{n}").exists()
        )
        try:
            self.path.rename(aside)
            journal = self.folder / "study.sqlite-journal"
            if journal.exists():
                journal.rename(self.folder / f"{aside.name}-journal")
        except OSError as error:
            raise StoreError(
                f"{self.path}: is damaged ({reason}) and cannot be put aside ({error.strerror})"
            ) from None
        self.db = self._connect()
        self._check()
        rows = list(read_damaged(aside))
        with self._transaction():
            self.db.executemany(
                "INSERT OR IGNORE INTO results (key, status, arrays, body, crc) VALUES (?, ?, ?,"
                " ?, ?)",
                [(r.key, r.status, r.arrays, r.body, r.crc) for r in rows],
            )
        self.salvaged = len(rows)

    # ---- one writer

    def acquire(self) -> int:
        """Takes the lease, or says who holds it. Then puts away what is damaged, and returns how
        many results that were.
        """
        try:
            (state,) = self.db.execute("PRAGMA integrity_check(1)").fetchone()
        except sqlite3.Error as error:
            if isinstance(error, sqlite3.OperationalError):
                raise self._said(error) from None
            state = str(error)
        if state != "ok":
            self.db.close()
            self._salvage(state)
        self._lease()
        return self._verify()

    def _lease(self) -> None:
        owner, host = uuid.uuid4().hex, machine()
        now = time.time()
        with self._transaction():
            held = self.db.execute("SELECT host, pid, started, renewed FROM lease").fetchone()
            if held is not None and alive(held):
                raise StoreError(
                    f"{self.path}: this study is being run by process {held[1]} on"
                    f" {held[0].split('/')[0]}; `jaxid batch STUDY.toml --status` shows how far"
                    " it is"
                )
            self.db.execute(
                "INSERT OR REPLACE INTO lease (id, owner, host, pid, started, renewed, running)"
                " VALUES (1, ?, ?, ?, ?, ?, 0)",
                (owner, host, os.getpid(), process_start(os.getpid()), now),
            )
        self.owner = owner

    def _verify(self) -> int:
        """Moves rows whose checksum does not hold into the table `damaged`; their tasks run
        again.
        """
        bad = [number for number, row in self._rows() if row is None]
        if bad:
            with self._transaction():
                for number in bad:
                    self.db.execute(
                        "INSERT INTO damaged (found, key, status, arrays, body, crc) "
                        "SELECT ?, key, status, arrays, body, crc FROM results WHERE id = ?",
                        (time.time(), number),
                    )
                    self.db.execute("DELETE FROM results WHERE id = ?", (number,))
        return len(bad)

    def renew(self, running: int) -> None:
        """Says that this process is alive, and how many tasks it has handed out."""
        self._write(*self._renewal(running))

    def _renewal(self, running: int) -> tuple[str, tuple]:
        return "UPDATE lease SET renewed = ?, running = ? WHERE owner = ?", (
            time.time(),
            running,
            self.owner,
        )

    def save(self, rows: Sequence[StudyRow], running: int = 0) -> None:
        """Saves finished tasks, all or none; when it returns they are on the disk. A task that has
        a result keeps it.
        """
        with self._transaction(len(rows)):
            if not self.db.execute(*self._renewal(running)).rowcount:
                raise LeaseLost(
                    f"{self.path}: another process has taken this study over; this one stops"
                )
            self.db.executemany(
                "INSERT OR IGNORE INTO results (key, status, arrays, body, crc) VALUES (?, ?, ?,"
                " ?, ?)",
                [(r.key, r.status, r.arrays, r.body, r.crc) for r in rows],
            )

    def save_arrays(self, name: str, arrays: Mapping[str, Any]) -> str:
        """Writes a file of arrays, whole or not at all; returns its name, for the rows that refer
        to it.
        """
        import numpy as np

        buffer = io.BytesIO()
        np.savez(buffer, **arrays)
        path = self.folder / "arrays" / f"{name}.npz"
        partial = path.with_suffix(f".{os.getpid()}.partial")
        try:
            path.parent.mkdir(exist_ok=True)
            with open(partial, "wb") as file:
                file.write(buffer.getvalue())
                file.flush()
                os.fsync(file.fileno())
            partial.replace(path)
        except OSError as error:
            partial.unlink(missing_ok=True)
            raise self._cannot_write(error.strerror or str(error), len(arrays)) from None
        return path.name

    def sweep(self) -> None:
        """Removes files of arrays that no row names: what a kill between rename and commit left.
        The lease is held.
        """
        used = {name for (name,) in self.db.execute("SELECT DISTINCT arrays FROM results")}
        for path in (self.folder / "arrays").glob("*"):
            if path.name not in used:
                path.unlink(missing_ok=True)

    def forget(self, keys: Iterable[str]) -> None:
        """Takes results out, so that their tasks run again."""
        with self._transaction():
            self.db.executemany("DELETE FROM results WHERE key = ?", [(k,) for k in keys])

    def remember(self, key: str, value: str) -> None:
        self._write("INSERT OR REPLACE INTO meta (key, value) VALUES (?, ?)", (key, value))

    def recall(self, key: str) -> str | None:
        found = self.db.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
        return found[0] if found else None

    # ---- reading

    def rows(self) -> Iterator[StudyRow]:
        """Every result whose checksum holds."""
        for _, row in self._rows():
            if row is not None:
                yield row

    def _rows(self) -> Iterator[tuple[int, StudyRow | None]]:
        try:
            for number, *fields in self.db.execute(f"SELECT {COLUMNS} FROM results ORDER BY id"):
                yield number, sound(fields)
        except sqlite3.Error as error:
            raise self._said(error) from None

    def running(self) -> int:
        """Tasks handed out by a process that is alive."""
        held = self.db.execute("SELECT host, pid, started, renewed, running FROM lease").fetchone()
        return held[4] if held is not None and alive(held) else 0

    def arrays(self, row: StudyRow) -> dict[str, Any]:
        """The history of a task [points 2]: evaluations and best loss so far; empty where it has
        none or its file is gone.
        """
        import numpy as np

        path = self.folder / "arrays" / row.arrays
        if not row.arrays or Path(row.arrays).name != row.arrays or not path.is_file():
            return {}
        try:
            with np.load(path, allow_pickle=False) as file:
                return {"history": file[row.key]} if row.key in file else {}
        except (OSError, ValueError, zlib.error, KeyError, EOFError, NotImplementedError):
            return {}
        except Exception as error:  # zipfile.BadZipFile, without importing zipfile for it
            if type(error).__name__ == "BadZipFile":
                return {}
            raise

    # ---- transactions

    def _write(self, statement: str, values: tuple = ()) -> None:
        with self._transaction():
            self.db.execute(statement, values)

    def _transaction(self, unsaved: int = 0) -> _Transaction:
        return _Transaction(self, unsaved)

    def _said(self, error: Exception, unsaved: int = 0) -> StoreError:
        """SQLite's error as a sentence that says what to do."""
        code = getattr(error, "sqlite_errorname", "") or ""
        if code.startswith(("SQLITE_FULL", "SQLITE_IOERR")):
            return self._cannot_write(
                "the disk is full" if code == "SQLITE_FULL" else f"the disk fails ({code})", unsaved
            )
        if code.startswith(("SQLITE_READONLY", "SQLITE_CANTOPEN", "SQLITE_PERM", "SQLITE_AUTH")):
            verb = "written" if self.writable else "read"
            return StoreError(
                f"{self.path}: cannot be {verb} ({error}); check its permissions, or name another"
                " `store`"
            )
        if code.startswith(("SQLITE_BUSY", "SQLITE_LOCKED")):
            return StoreError(
                f"{self.path}: is locked by another process for more than {BUSY_S:g} s; try again"
            )
        return StoreError(
            f"{self.path}: is damaged ({error}); run the study again: what can be read is kept, the"
            " rest is computed anew"
        )

    def _cannot_write(self, why: str, unsaved: int) -> StoreError:
        lost = f"{unsaved} finished tasks could not be saved; " if unsaved else ""
        return StoreError(
            f"{self.path}: cannot be written, {why}; {lost}everything saved before is intact. Make"
            " room (or free the quota) and start the same command again: it goes on where it"
            " stopped"
        )


class _Transaction:
    """BEGIN IMMEDIATE … COMMIT; on any error everything is rolled back and SQLite's word becomes a
    sentence.
    """

    def __init__(self, store: Store, unsaved: int):
        self.store, self.unsaved = store, unsaved

    def __enter__(self) -> None:
        try:
            self.store.db.execute("BEGIN IMMEDIATE")
        except sqlite3.Error as error:
            raise self.store._said(error, self.unsaved) from None

    def __exit__(self, kind, error, trace) -> None:
        db = self.store.db
        try:
            if kind is None:
                db.execute("COMMIT")
                return
        except sqlite3.Error as failed:
            error = failed
        if db.in_transaction:
            try:
                db.execute("ROLLBACK")
            except sqlite3.Error:
                pass  # a full disk may have rolled back by itself
        if isinstance(error, sqlite3.Error):
            raise self.store._said(error, self.unsaved) from None


# ---- who holds the lease
