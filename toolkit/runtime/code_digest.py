"""Digest of a job's source: results on disk are valid only while their code is the same. The source of a job is its
import closure: its module, the imports of that, inside functions too, and so on, within the house, but not of code
under `if TYPE_CHECKING:`. A package whose face loads lazily adds only the names that are asked of it, as its stub says.
Libraries count by their version."""

from __future__ import annotations

import ast
import sys
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

TOP = Path(__file__).parents[2]  # of this checkout or installation
PACKAGES = ("toolkit", "models", "placement_env")

_Import = tuple[str, str]  # a module, and a name asked of it or ""


@cache
def code_digest(*modules: str) -> str:
    """SHA-256 over the source that `modules` run."""
    return digest_of_source(modules)


def digest_of_source(modules: tuple[str, ...], top: Path = TOP) -> str:
    """Compute `code_digest` of the source below `top`, read now."""
    files, libraries = import_closure(modules, top)
    digest = sha256()
    for module in sorted(files):
        digest.update(module.encode() + b"\0" + sha256(files[module].read_bytes()).digest())
    for library in sorted(libraries):
        digest.update(f"{library} {_version(library)}\n".encode())
    return digest.hexdigest()


def import_closure(modules: tuple[str, ...], top: Path = TOP) -> tuple[dict[str, Path], set[str]]:
    """Source files and libraries that `modules` import, directly or not."""
    files: dict[str, Path] = {}
    libraries: set[str] = set()
    pending: list[_Import] = [(module, "") for module in modules]
    done: set[_Import] = set()
    while pending:
        module, name = pending.pop()
        if (module, name) in done:
            continue
        done.add((module, name))
        parent = module.rpartition(".")[0]
        pending.extend([(parent, "")] if parent and _is_ours(module) else [])
        path = _file(module, top) if _is_ours(module) or module in modules else None
        if path is None:
            libraries.update(set() if _is_ours(module) else {module.partition(".")[0]} - sys.stdlib_module_names)
            continue
        if name and path.name == "__init__.py":
            below = f"{module}.{name}"
            stub = path.with_suffix(".pyi")
            offered = _offers((stub if stub.is_file() else path).read_bytes(), module, name)
            pending.extend([(below, "")] if _file(below, top) else offered)
        if module not in files:
            files[module] = path
            pending.extend(_imports(path.read_bytes(), module, path.name == "__init__.py"))
    return files, libraries


def _is_ours(module: str) -> bool:
    return module.partition(".")[0] in PACKAGES


def _file(module: str, top: Path) -> Path | None:
    if not _is_ours(module):
        loaded = getattr(sys.modules.get(module), "__file__", None)
        return Path(loaded) if loaded and loaded.endswith(".py") else None
    path = top.joinpath(*module.split("."))
    return next((each for each in (path.with_suffix(".py"), path / "__init__.py") if each.is_file()), None)


@cache
def _imports(source: bytes, module: str, is_package: bool) -> tuple[_Import, ...]:
    """Imports of a module when it and its functions run, but not those that only type checkers read."""
    found: list[_Import] = []
    pending: list[ast.AST] = [ast.parse(source)]
    while pending:
        node = pending.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            found += _list_imports(node, module if is_package else module.rpartition(".")[0])
        test = node.test if isinstance(node, ast.If) and isinstance(node.test, ast.Name | ast.Attribute) else None
        skipped = test is not None and ast.unparse(test).rpartition(".")[2] == "TYPE_CHECKING"
        for block in ("orelse",) if skipped else ("body", "orelse", "handlers", "finalbody", "cases"):
            inner = getattr(node, block, ())
            pending.extend(inner if isinstance(inner, list) else ())
    return tuple(found)


def _list_imports(node: ast.Import | ast.ImportFrom, package: str) -> list[_Import]:
    if isinstance(node, ast.Import):
        return [(alias.name, "") for alias in node.names]
    parts = package.split(".")
    above = parts[: len(parts) - node.level + 1] if node.level else []
    module = ".".join([*above, *([node.module] if node.module else [])])
    return [(module, alias.name) for alias in node.names]


@cache
def _offers(source: bytes, package: str, name: str) -> tuple[_Import, ...]:
    """Modules from which a face imports `name`."""
    offered: dict[str, _Import] = {}
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            places = _list_imports(node, package)
            offered |= {alias.asname or alias.name: place for alias, place in zip(node.names, places, strict=True)}
    return tuple(place for key, place in offered.items() if name in ("*", key))


@cache
def _version(library: str) -> str:
    for name in (library, f"{library}-cpu"):  # Open3D has a distribution for each
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return ""
