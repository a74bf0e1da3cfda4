"""`Cache`: arrays that took long to compute, by a key.

A key (`make_key`) states everything that the arrays depend on, so they never change. The file is an
SQLite database with a write-ahead log, so that several processes read and write it in parallel, and
a process killed while writing leaves it unchanged. Each value is signed, over key and value, with a
secret in a file next to it that only its owner may read. A value whose signature does not fit
(damaged, forged, of an older version) is computed again. A damaged file is renamed, with a warning,
and started afresh.

Digest of a job's source: results on disk are valid only while their code is the same. The source of
a job is its import closure: its module and, recursively, the modules of this project that it
imports, inside functions too, but not under `if TYPE_CHECKING:`. A package with lazy imports adds
only the names that are imported from it, as its stub defines them. Libraries count by their
version."""

import ast
import hashlib
import json
import math
import os
import secrets
import sqlite3
import sys
import tempfile
import time
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TypeVar

import numpy as np

from toolkit.runtime.sent_once import SentOnce

Arrays = tuple[np.ndarray, ...]
_Outcome = TypeVar("_Outcome")

MAX_WAIT_S = 60.0  # for another process that writes
QUERY_KEYS = 500  # in one query
CHECKSUM_BYTES = 16
SECRET_BYTES = 32
MIN_COMPRESSED_BYTES = 1 << 14  # larger values are compressed
MAX_VALUE_BYTES = 1 << 29  # compressed value; SQLite takes a little more
ARRAY_KINDS = "biufcmMSU"  # NumPy's types that are plain bytes, so no objects and no records
CACHE_SCHEMA = (
    "CREATE TABLE IF NOT EXISTS entries (key BLOB PRIMARY KEY, value BLOB NOT NULL) WITHOUT ROWID"
)
SOURCE_ROOT = Path(__file__).parents[2]  # folder of this checkout or installation
PACKAGES = ("toolkit", "models", "placement_env")
_Import = tuple[str, str]  # a module, and a name imported from it or ""


def make_key(*parts: object) -> bytes:
    """SHA-256 of texts, numbers, lists and dictionaries, as JSON."""
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).digest()


class Cache(SentOnce):
    """Tuples of arrays by key, in a file or in memory.

    path: the file, made if missing, None for memory only. In another process, a cache opens the
    same file; in memory, each process has a separate one. If the file cannot be written, or others
    can read its secret, the cache warns and works without the file."""

    def __init__(self, path: str | Path | None = None) -> None:
        self.path = None if path is None else Path(path)
        self._open: tuple[int, sqlite3.Connection] | None = None  # process that opened it, handle
        self._inode: int | None = None  # the file's when it was opened
        self._secret = b""

    def get(self, keys: Sequence[bytes]) -> list[Arrays | None]:
        """Return the value of each key, in order; None for unknown keys and damaged values."""

        def select(database: sqlite3.Connection) -> dict[bytes, bytes]:
            """Stored values by key, asked for `QUERY_KEYS` keys at a time."""
            values: dict[bytes, bytes] = {}
            for start in range(0, len(keys), QUERY_KEYS):
                chunk = list(keys[start : start + QUERY_KEYS])
                query = (
                    f"SELECT key, value FROM entries WHERE key IN ({','.join('?' * len(chunk))})"
                )
                values |= dict(database.execute(query, chunk))
            return values

        # without a usable file nothing is known; values signed with another secret count as damaged
        values = self._safely(select, dict[bytes, bytes]())
        return [
            decode_arrays(key + self._secret, values[key]) if key in values else None
            for key in keys
        ]

    def put(self, values: Mapping[bytes, Iterable[np.ndarray]]) -> None:
        """Keep all values or, if the process ends before, none.

        values: arrays by key; values above `MAX_VALUE_BYTES` are left out with a warning."""

        def insert(database: sqlite3.Connection) -> None:
            """Write all values that are not too large, in one transaction."""
            rows = [
                (key, encode_arrays(key + self._secret, value)) for key, value in values.items()
            ]
            fitting_rows = [(key, value) for key, value in rows if len(value) <= MAX_VALUE_BYTES]
            too_large_count = len(rows) - len(fitting_rows)
            if too_large_count:
                warnings.warn(
                    f"{too_large_count} values are too large to be kept in {self.path}",
                    stacklevel=4,
                )
            with database:  # commits, or rolls back
                database.execute("BEGIN IMMEDIATE")
                database.executemany("INSERT OR REPLACE INTO entries VALUES (?, ?)", fitting_rows)

        self._safely(insert, otherwise=None)

    def __len__(self) -> int:
        return self._safely(
            lambda db: int(db.execute("SELECT count(*) FROM entries").fetchone()[0]), otherwise=0
        )

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
        for suffix in ("", "-wal", "-shm", ".key") if self.path is not None else ():
            Path(f"{self.path}{suffix}").unlink(missing_ok=True)

    def _safely(
        self, call: Callable[[sqlite3.Connection], _Outcome], otherwise: _Outcome
    ) -> _Outcome:
        """Result of a call, repeated on a new file if this one is damaged, else `otherwise`."""
        for is_new_file in (False, True):
            try:
                return call(self._database())
            except sqlite3.OperationalError as error:
                # locked too long, read-only, disk full: the file may be sound
                warnings.warn(
                    f"{self.path} cannot be used ({error}): what it keeps is computed again",
                    stacklevel=3,
                )
                self.close()
                return otherwise
            except sqlite3.DatabaseError as error:
                self.close()
                if not is_new_file:
                    self._put_aside(str(error))
        return otherwise

    def _database(self) -> sqlite3.Connection:
        """Open database of this process. Raises sqlite3.Error if the file cannot be used."""
        # `_open` is process id and database, since a forked process must not share a handle
        if self._open is not None and self._open[0] == os.getpid():
            return self._open[1]
        if self.path is not None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        database = sqlite3.connect(
            self.path or ":memory:",
            timeout=MAX_WAIT_S,
            isolation_level=None,
            check_same_thread=False,
        )
        self._inode = self._on_disk()
        try:
            for statement in ("PRAGMA journal_mode=WAL", "PRAGMA synchronous=NORMAL", CACHE_SCHEMA):
                _patiently(database, statement)
            self._secret = b"" if self.path is None else read_secret(Path(f"{self.path}.key"))
        except sqlite3.Error:
            database.close()
            raise
        except OSError as error:
            database.close()
            raise sqlite3.OperationalError(str(error)) from error
        database.text_factory = bytes  # whatever a row holds, it is read as bytes
        self._open = os.getpid(), database
        return database

    def _on_disk(self) -> int | None:
        """Number (inode) of the file that has the cache's path now, None without one."""
        return self.path.stat().st_ino if self.path is not None and self.path.exists() else None

    def _put_aside(self, error: str) -> None:
        """Rename the damaged file, with a warning that gives the error."""
        # another process may have started it afresh already
        if self.path is None or self._on_disk() != self._inode:
            return
        aside = self.path.with_name(f"{self.path.name}.damaged-{os.getpid()}")
        warnings.warn(
            f"{self.path} is damaged ({error}): put aside as {aside.name} and begun anew",
            stacklevel=4,
        )
        for suffix in ("", "-wal", "-shm"):
            try:
                os.replace(f"{self.path}{suffix}", f"{aside}{suffix}")
            except FileNotFoundError:  # missing, or put aside by another process
                continue


def recall(
    cache: Cache | None,
    keys: Sequence[bytes],
    make: Callable[[list[int]], Iterable[Iterable[np.ndarray]]],
) -> Iterator[Arrays]:
    """Yield the value of each key, from the cache or computed and then stored.

    make: from the indices of missing keys to their values, in order; each is computed when it is
    taken from the iterator."""
    cached_values: list[Arrays | None] = [None] * len(keys) if cache is None else cache.get(keys)
    missing_indices = [index for index, arrays in enumerate(cached_values) if arrays is None]
    results = iter(make(missing_indices) if missing_indices else ())
    for key, arrays in zip(keys, cached_values, strict=True):
        value = tuple(next(results)) if arrays is None else arrays
        if arrays is None and cache is not None:
            cache.put({key: value})
        yield value


def read_secret(path: Path) -> bytes:
    """Secret in a file that only its owner may read, made if missing.

    Raises PermissionError for a file that others can read."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor, new_file = tempfile.mkstemp(dir=path.parent)  # with mode 0600
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(secrets.token_bytes(SECRET_BYTES))
            os.link(new_file, path)  # the name appears with its content, for one process only
        except FileExistsError:  # another process was first
            pass
        except OSError:  # no links here
            os.replace(new_file, path)
        finally:
            Path(new_file).unlink(missing_ok=True)
    # a pipe has nothing, and must not be waited for
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(file.fileno())
        secret = file.read(SECRET_BYTES) or b""
    is_private = not hasattr(os, "geteuid") or (
        status.st_uid == os.geteuid() and not status.st_mode & 0o077
    )
    if not is_private or len(secret) < SECRET_BYTES:
        raise PermissionError(
            f"{path.name} is not a secret of yours alone: remove it, or give a folder of your own"
        )
    return secret


def encode_arrays(key: bytes, arrays: Iterable[np.ndarray]) -> bytes:
    """Arrays as bytes: checksum, a line of JSON (compressed or not, types and shapes), content.

    key: for the checksum. Raises ValueError for arrays of objects."""
    plain_arrays = [np.ascontiguousarray(array) for array in arrays]
    for array in plain_arrays:
        if array.dtype.kind not in ARRAY_KINDS:
            raise ValueError(
                f"a cache keeps plain arrays, got one of {array.dtype}: keep its fields one by one"
            )
    content = b"".join(array.tobytes() for array in plain_arrays)
    is_compressed = len(content) >= MIN_COMPRESSED_BYTES
    description = [is_compressed, *((array.dtype.str, array.shape) for array in plain_arrays)]
    if is_compressed:
        content = zlib.compress(content, 1)
    body = json.dumps(description).encode() + b"\n" + content
    return _checksum(key, body) + body


def decode_arrays(key: bytes, value: bytes) -> Arrays | None:
    """Return the arrays that `encode_arrays` put into `value`; None if it is damaged or no bytes.

    key: the same as for `encode_arrays`, which the checksum covers. The arrays are read-only."""
    # checksum, then [is_compressed, [dtype, shape], ...] as a line of JSON, then the arrays' bytes
    body = value[CHECKSUM_BYTES:] if isinstance(value, bytes) else b""
    if not body or not secrets.compare_digest(value[:CHECKSUM_BYTES], _checksum(key, body)):
        return None
    head, _, content = body.partition(b"\n")
    try:
        is_compressed, *types_and_shapes = json.loads(head)
        types = [np.dtype(str(dtype)) for dtype, _ in types_and_shapes]
        shapes = [list(map(int, shape)) for _, shape in types_and_shapes]
        sizes = [  # bytes of each array
            dtype.itemsize * math.prod(shape) for dtype, shape in zip(types, shapes, strict=True)
        ]
        if any(dtype.kind not in ARRAY_KINDS for dtype in types):
            return None
        if any(length < 0 for shape in shapes for length in shape):
            return None
        if is_compressed:
            # at most one byte more than expected, which shows that it does not fit
            content = zlib.decompressobj().decompress(content, sum(sizes) + 1)
        if len(content) != sum(sizes):
            return None
        offsets = np.cumsum([0, *sizes]).tolist()
        return tuple(
            np.ndarray(shape, dtype, content, offset)
            for shape, dtype, offset in zip(shapes, types, offsets, strict=False)
        )
    except (ValueError, TypeError, IndexError, OverflowError, RecursionError, zlib.error):
        return None


def _checksum(key: bytes, body: bytes) -> bytes:
    """Keyed hash of a value."""
    return hashlib.blake2b(body, digest_size=CHECKSUM_BYTES, key=key).digest()


def _patiently(database: sqlite3.Connection, statement: str) -> None:
    """Execute a statement again and again while the database is locked, for `MAX_WAIT_S` at most.

    SQLite itself does not wait for some statements, such as a change of the journal's mode."""
    until = time.monotonic() + MAX_WAIT_S
    while True:
        try:
            database.execute(statement)
            return
        except sqlite3.OperationalError as error:
            # the lowest 8 bits are the kind of the error, the others details
            if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY or time.monotonic() > until:
                raise
            time.sleep(0.02)


@cache
def code_digest(*modules: str) -> str:
    """SHA-256 over the source that `modules` run, and the tables (TOML) in its folders."""
    return digest_of_source(modules)


def digest_of_source(modules: tuple[str, ...], top: Path = SOURCE_ROOT) -> str:
    """SHA-256 of the modules and of all that they import, read from the source below `top`.

    Tables next to modules of ours, and versions of libraries, count too."""
    files, libraries = import_closure(modules, top)
    digest = sha256()
    for module in sorted(files):
        digest.update(module.encode() + b"\0" + sha256(files[module].read_bytes()).digest())
    folders = {path.parent for module, path in files.items() if _is_ours(module)}
    # data files next to the modules count too
    tables = sorted(table for folder in folders for table in folder.glob("*.toml"))
    for data in tables:
        digest.update(data.name.encode() + b"\0" + sha256(data.read_bytes()).digest())
    for library in sorted(libraries):
        digest.update(f"{library} {_version(library)}\n".encode())
    return digest.hexdigest()


def import_closure(
    modules: tuple[str, ...], top: Path = SOURCE_ROOT
) -> tuple[dict[str, Path], set[str]]:
    """Source files of this project, by module, that `modules` import, directly or not.

    The second result holds the names of the libraries outside it and outside Python that they
    import. top: folder that holds the packages of this project.
    """
    files: dict[str, Path] = {}
    libraries: set[str] = set()
    pending: list[_Import] = [(module, "") for module in modules]
    followed: set[_Import] = set()
    while pending:
        module, name = pending.pop()
        if (module, name) in followed:
            continue
        followed.add((module, name))
        parent = module.rpartition(".")[0]  # its package, which runs before it
        pending.extend([(parent, "")] if parent and _is_ours(module) else [])
        path = _file(module, top) if _is_ours(module) or module in modules else None
        if path is None:
            libraries.update(
                set() if _is_ours(module) else {module.partition(".")[0]} - sys.stdlib_module_names
            )
            continue
        # a name of a package is a module below it, or one that its stub or __init__ imports
        if name and path.name == "__init__.py":
            below = f"{module}.{name}"
            stub = path.with_suffix(".pyi")
            offered_imports = _offers((stub if stub.is_file() else path).read_bytes(), module, name)
            pending.extend([(below, "")] if _file(below, top) else offered_imports)
        if module not in files:
            files[module] = path
            pending.extend(_imports(path.read_bytes(), module, path.name == "__init__.py"))
    return files, libraries


def _is_ours(module: str) -> bool:
    """True for a module of this project."""
    return module.partition(".")[0] in PACKAGES


def _file(module: str, top: Path) -> Path | None:
    """Source file of a module, None without one.

    A module of ours is looked up below `top`; a library's file is known only if it is loaded."""
    if not _is_ours(module):
        loaded_file = getattr(sys.modules.get(module), "__file__", None)
        return Path(loaded_file) if loaded_file and loaded_file.endswith(".py") else None
    path = top.joinpath(*module.split("."))
    candidates = (path.with_suffix(".py"), path / "__init__.py")
    return next((candidate for candidate in candidates if candidate.is_file()), None)


@cache
def _imports(source: bytes, module: str, is_package: bool) -> tuple[_Import, ...]:
    """Imports of a module when it and its functions run, without imports for type checkers only.

    source: its text; module: its dotted name; is_package: it is the __init__.py of a package."""
    imports: list[_Import] = []
    pending: list[ast.AST] = [ast.parse(source)]
    while pending:
        node = pending.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            imports += _list_imports(node, module if is_package else module.rpartition(".")[0])
        is_for_checkers = False
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name | ast.Attribute):
            is_for_checkers = ast.unparse(node.test).rpartition(".")[2] == "TYPE_CHECKING"
        blocks = ["orelse"]  # fields of a node that hold statements
        if not is_for_checkers:
            blocks = ["body", "orelse", "handlers", "finalbody", "cases"]
        for block in blocks:
            statements = getattr(node, block, ())  # a lambda's body is an expression, no list
            pending.extend(statements if isinstance(statements, list) else ())
    return tuple(imports)


def _list_imports(node: ast.Import | ast.ImportFrom, package: str) -> list[_Import]:
    """Imports of a statement in a module of a package: modules, and the names from them.

    node: the statement; package: dotted name of the package, from which relative imports count."""
    if isinstance(node, ast.Import):
        return [(alias.name, "") for alias in node.names]
    parts = package.split(".")
    # one dot is the package itself, each further one the package above
    base = parts[: len(parts) - node.level + 1] if node.level else []
    module = ".".join([*base, *([node.module] if node.module else [])])
    return [(module, alias.name) for alias in node.names]


@cache
def _offers(source: bytes, package: str, name: str) -> tuple[_Import, ...]:
    """Imports by which a package's `__init__` or stub offers `name`; all imports for "*".

    source: text of the file; package: its name, from which relative imports start."""
    by_name: dict[str, _Import] = {}
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            targets = _list_imports(node, package)
            for alias, target in zip(node.names, targets, strict=True):
                by_name[alias.asname or alias.name] = target
    return tuple(target for key, target in by_name.items() if name in ("*", key))


@cache
def _version(library: str) -> str:
    """Installed version of a library, "" if unknown."""
    for name in (library, f"{library}-cpu"):  # Open3D has a distribution for each
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return ""
