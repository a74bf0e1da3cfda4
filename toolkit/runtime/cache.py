"""`Cache`: arrays that took long to compute, by a key (`make_key`) that says all they depend on, so they never change.
The file is an SQLite database with a write-ahead log, so that several processes read and write it at once, and a
process killed while writing leaves it as it was before. Each value has a checksum over key and value; one that does not
fit is computed again. A damaged file is put aside under another name, with a warning, and begun anew."""

from __future__ import annotations

import hashlib
import json
import math
import os
import sqlite3
import time
import warnings
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

Arrays = tuple[np.ndarray, ...]
_Outcome = TypeVar("_Outcome")

WAIT = 60.0  # s that a process waits while another one writes
AT_ONCE = 500  # keys in one question
CHECKSUM = 8  # bytes
COMPRESSED = 1 << 14  # bytes, from which on a value is compressed
LARGEST_VALUE = 1 << 29  # bytes of a value, compressed; SQLite takes a little more
ARRAY_KINDS = "biufcmMSU"  # of NumPy's types: those that are plain bytes, so no objects and no records
CACHE_SCHEMA = "CREATE TABLE IF NOT EXISTS entries (key BLOB PRIMARY KEY, value BLOB NOT NULL) WITHOUT ROWID"


def make_key(*parts: object) -> bytes:
    """SHA-256 of texts, numbers, lists and dictionaries, as JSON.

    >>> make_key("early", [0, 1]) == make_key("early", (0, 1)), make_key("early", [0, 1]) == make_key("early", [0, 2])
    (True, False)
    """
    return hashlib.sha256(json.dumps(parts, sort_keys=True, separators=(",", ":")).encode()).digest()


class Cache:
    """Tuples of arrays by key, in a file or in memory. path: of the file, made if missing, None for memory only. Sent
    to another process, it opens the file again there; in memory, each process has its own. If the file cannot be
    written, it warns and goes on without.

    >>> cache = Cache()
    >>> cache.put({make_key("a"): (np.arange(3),)})
    >>> cache.get([make_key("a"), make_key("b")])
    [(array([0, 1, 2]),), None]
    """

    def __init__(self, path: str | Path | None = None) -> None:
        self.path = None if path is None else Path(path)
        self._open: tuple[int, sqlite3.Connection] | None = None
        self._inode: int | None = None

    def get(self, keys: Sequence[bytes]) -> list[Arrays | None]:
        """Values of some keys, None for unknown ones."""

        def select(database: sqlite3.Connection) -> dict[bytes, bytes]:
            found: dict[bytes, bytes] = {}
            for first in range(0, len(keys), AT_ONCE):
                some = list(keys[first : first + AT_ONCE])
                query = f"SELECT key, value FROM entries WHERE key IN ({','.join('?' * len(some))})"
                found |= dict(database.execute(query, some))
            return found

        nothing: dict[bytes, bytes] = {}
        found = self._safely(select, nothing)
        return [decode_arrays(key, found[key]) if key in found else None for key in keys]

    def put(self, values: Mapping[bytes, Iterable[np.ndarray]]) -> None:
        """Keep all values or, if the process ends before, none."""
        rows = [(key, encode_arrays(key, value)) for key, value in values.items()]
        fitting = [row for row in rows if len(row[1]) <= LARGEST_VALUE]
        if len(fitting) < len(rows):
            warnings.warn(f"{len(rows) - len(fitting)} values are too large to be kept in {self.path}", stacklevel=2)

        def insert(database: sqlite3.Connection) -> None:
            database.execute("BEGIN IMMEDIATE")
            try:
                database.executemany("INSERT OR REPLACE INTO entries VALUES (?, ?)", fitting)
            except BaseException:
                database.execute("ROLLBACK")
                raise
            database.execute("COMMIT")

        self._safely(insert, None)

    def __len__(self) -> int:
        return self._safely(lambda db: int(db.execute("SELECT count(*) FROM entries").fetchone()[0]), 0)

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_open": None}

    def close(self) -> None:
        """Close the file; the next access opens it again."""
        if self._open is not None and self._open[0] == os.getpid():
            self._open[1].close()
        self._open = None

    def delete(self) -> None:
        """Remove the file and all it keeps."""
        self.close()
        for suffix in ("", "-wal", "-shm") if self.path is not None else ():
            Path(f"{self.path}{suffix}").unlink(missing_ok=True)

    def _safely(self, call: Callable[[sqlite3.Connection], _Outcome], otherwise: _Outcome) -> _Outcome:
        """Result of a call; of the call on a new file if this one is damaged. `otherwise` if neither works."""
        for attempt in ("as it is", "begun anew"):
            try:
                return call(self._database())
            except sqlite3.OperationalError as error:  # locked too long, read-only, disk full: the file may be sound
                warnings.warn(f"{self.path} cannot be used ({error}): what it keeps is computed again", stacklevel=3)
                self.close()
                return otherwise
            except sqlite3.DatabaseError as error:
                self.close()
                if attempt == "as it is":
                    self._put_aside(str(error))
        return otherwise

    def _database(self) -> sqlite3.Connection:
        if (
            self._open is not None and self._open[0] == os.getpid()
        ):  # a forked process must not share the parent's handle
            return self._open[1]
        if self.path is not None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        database = sqlite3.connect(self.path or ":memory:", timeout=WAIT, isolation_level=None, check_same_thread=False)
        self._inode = self._on_disk()
        try:
            for statement in ("PRAGMA journal_mode=WAL", "PRAGMA synchronous=NORMAL", CACHE_SCHEMA):
                _patiently(database, statement)
        except sqlite3.Error:
            database.close()
            raise
        self._open = os.getpid(), database
        return database

    def _on_disk(self) -> int | None:
        return self.path.stat().st_ino if self.path is not None and self.path.exists() else None

    def _put_aside(self, error: str) -> None:
        if self.path is None or self._on_disk() != self._inode:  # another process has begun it anew already
            return
        aside = self.path.with_name(f"{self.path.name}.damaged-{os.getpid()}")
        warnings.warn(f"{self.path} is damaged ({error}): put aside as {aside.name} and begun anew", stacklevel=4)
        for suffix in ("", "-wal", "-shm"):
            try:
                os.replace(f"{self.path}{suffix}", f"{aside}{suffix}")
            except FileNotFoundError:  # missing, or put aside by another process
                continue


def encode_arrays(key: bytes, arrays: Iterable[np.ndarray]) -> bytes:
    """Encode arrays: checksum, a line of JSON with types and shapes, content. Raises ValueError for arrays of objects
    or records."""
    columns = [np.ascontiguousarray(column) for column in arrays]
    for column in columns:
        if column.dtype.kind not in ARRAY_KINDS:
            raise ValueError(f"a cache keeps plain arrays, got one of {column.dtype}: keep its fields one by one")
    content = b"".join(column.tobytes() for column in columns)
    compressed = len(content) >= COMPRESSED
    described = [compressed, *((column.dtype.str, column.shape) for column in columns)]
    body = json.dumps(described).encode() + b"\n" + (zlib.compress(content, 1) if compressed else content)
    return _checksum(key, body) + body


def decode_arrays(key: bytes, value: bytes) -> Arrays | None:
    """Decode arrays of `encode_arrays`; None for damaged bytes."""
    body = value[CHECKSUM:]
    if value[:CHECKSUM] != _checksum(key, body):
        return None
    head, _, content = body.partition(b"\n")
    try:
        compressed, *columns = json.loads(head)
        types = [np.dtype(str(dtype)) for dtype, _ in columns]
        shapes = [[int(length) for length in shape] for _, shape in columns]
        sizes = [dtype.itemsize * math.prod(shape) for dtype, shape in zip(types, shapes, strict=True)]
        if any(each.kind not in ARRAY_KINDS for each in types) or any(n < 0 for shape in shapes for n in shape):
            return None
        if compressed:
            content = zlib.decompressobj().decompress(content, sum(sizes) + 1)
        if len(content) != sum(sizes):
            return None
        first = np.cumsum([0, *sizes]).tolist()
        return tuple(np.ndarray(*each) for each in zip(shapes, types, [content] * len(types), first, strict=False))
    except (ValueError, TypeError, IndexError, OverflowError, RecursionError, zlib.error):
        return None


def _checksum(key: bytes, body: bytes) -> bytes:
    return hashlib.blake2b(body, digest_size=CHECKSUM, key=key).digest()


def _patiently(database: sqlite3.Connection, statement: str) -> None:
    """Execute a statement for which SQLite itself does not wait, such as a change of the journal's mode."""
    until = time.monotonic() + WAIT
    while True:
        try:
            database.execute(statement)
            return
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY or time.monotonic() > until:
                raise
            time.sleep(0.02)
