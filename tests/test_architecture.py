"""Check the structure of the packages: no import cycles between modules or folders, one meaning for
a name."""

import ast
import re
from collections import defaultdict
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FLOORS = ("toolkit", "models", "placement_env", "coview")
SOURCES = sorted(
    path.relative_to(ROOT) for floor in FLOORS for path in (ROOT / floor).rglob("*.py")
)

# of every built-in site, of page and command, and of every search
PROTOCOLS = {"build", "live", "search"}
# Words of this house that the field has other words for: see the glossary in CONTRIBUTING.md.
HOUSE_WORDS = {
    *(
        "board",
        "boards",
        "dear",
        "game",
        "games",
        "gaze",
        "hung",
        "lorries",
        "lorry",
        "sighting",
        "sightings",
        "told",
    )
}


def module_of(path):
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path): path for path in SOURCES}


def imports(path, tree):
    """The modules of ours that a file imports when it runs, inside functions too; not those for
    types alone."""

    def walk(node):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING":
                continue
            if isinstance(child, ast.Import):
                yield from (name.name for name in child.names)
            elif isinstance(child, ast.ImportFrom):
                assert not child.level, f"{path}: imports are absolute"
                for name in child.names:
                    inner = f"{child.module}.{name.name}"
                    yield inner if inner in MODULES else str(child.module)
            yield from walk(child)

    return {name for name in walk(tree) if name in MODULES}


@pytest.fixture(scope="module")
def trees(floor_trees):
    """Syntax trees of all files."""
    return {path: tree for files in floor_trees.values() for path, tree in files.items()}


@pytest.fixture(scope="module")
def import_graph(trees):
    """Modules of ours that each module imports."""
    return {name: imports(path, trees[path]) - {name} for name, path in MODULES.items()}


def test_no_cycle_of_imports_and_no_face_below(import_graph, trees):
    try:
        TopologicalSorter(import_graph).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(reversed(error.args[1])))
    # A face reaches everything, so that who imports one depends on everything: contracts and cache
    # keys lose
    # sight.
    assert {
        (name, face)
        for name, others in import_graph.items()
        for face in FLOORS[:3]
        if face in others
    } == set()
    assert set(folder_cycles(import_graph)) <= KNOWN_CYCLES
    assert [path for path, tree in trees.items() if not ast.get_docstring(tree)] == []


def folder_cycles(import_graph):
    """Pairs of neighbours in a folder, files or subfolders as a whole, that import each other."""
    for folder in {parent for path in SOURCES for parent in path.parents if parent.name}:
        depth, graph = len(folder.parts), defaultdict(set)
        for name, others in import_graph.items():
            here = MODULES[name].parts
            if here[:depth] == folder.parts and here[depth] != "__init__.py":
                graph[here[depth]] |= {
                    there[depth]
                    for there in (MODULES[other].parts for other in others)
                    if there[:depth] == folder.parts
                    and there[depth] not in ("__init__.py", here[depth])
                }
        yield from (
            f"{folder}: {a} <-> {b}" for a in graph for b in graph[a] if a < b and a in graph[b]
        )


KNOWN_CYCLES = {"toolkit/datasets: dataset.py <-> layouts"}


def public_names(tree):
    """Functions, classes and constants that a file defines for others."""
    for node in tree.body:
        targets = {
            ast.FunctionDef: lambda n: [n],
            ast.ClassDef: lambda n: [n],
            ast.Assign: lambda n: n.targets,
            ast.AnnAssign: lambda n: [n.target],
        }.get(type(node), lambda _: [])(node)
        for target in targets:
            found = (
                [target.name]
                if hasattr(target, "name")
                else [t.id for t in ast.walk(target) if hasattr(t, "id")]
            )
            yield from (name for name in found if not name.startswith("_"))


@pytest.mark.parametrize("floor", FLOORS)
def test_a_public_name_is_defined_once_in_a_floor(floor, floor_trees):
    defined = defaultdict(set)
    for path, tree in floor_trees[floor].items():
        for name in public_names(tree):
            defined[name].add(path)
    assert {name for name, paths in defined.items() if len(paths) > 1} - PROTOCOLS == set()


def names_given(tree):
    """What functions, classes, arguments, variables and fields of a file are called."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr


def test_names_are_in_the_words_of_the_field(trees):
    words = {
        path.as_posix(): {
            word.lower()
            for name in names_given(tree)
            for word in re.findall("[A-Z]?[a-z]+|[A-Z]+", name)
        }
        for path, tree in trees.items()
        if path.parts[0] != "coview"
    }
    assert {path for path, spoken in words.items() if spoken & HOUSE_WORDS} == set()
