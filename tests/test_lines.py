"""Lines that can be read aloud: one statement, one step.

The counts below are ceilings that only fall: whoever makes one smaller lowers it here."""

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

COMPREHENSIONS = (ast.ListComp, ast.GeneratorExp, ast.DictComp, ast.SetComp)
COORDINATES = frozenset("xyzuvwijkabc") | {"xmin", "ymin", "xmax", "ymax"}
CEILINGS = {
    "comprehension in a comprehension": 0,
    "three names bound at once": 147,
    "conditional expression in another": 0,
    "statement that is never reached": 0,
}


def contains(node: ast.AST, kinds: tuple[type[ast.AST], ...]) -> bool:
    return any(isinstance(below, kinds) for below in ast.walk(node) if below is not node)


def binds_many(node: ast.Assign) -> bool:
    """True for three names and more bound at once, coordinates aside."""
    target = node.targets[0]
    if not isinstance(target, ast.Tuple | ast.List) or len(target.elts) < 3:
        return False
    names = {name.id for name in ast.walk(target) if isinstance(name, ast.Name)}
    return not names <= COORDINATES


def list_unreached(node: ast.AST) -> list[ast.stmt]:
    """Statements of a node after one that leaves their block."""
    leaving = ast.Return | ast.Raise | ast.Continue | ast.Break
    blocks = [getattr(node, name, None) for name in ("body", "orelse", "finalbody")]
    unreached = []
    for block in blocks:
        statements = block if isinstance(block, list) else []
        for number, statement in enumerate(statements):
            if isinstance(statement, leaving):
                unreached += statements[number + 1 :]
    return unreached


def find_dense_nodes(tree: ast.Module) -> Iterator[tuple[str, ast.AST]]:
    """Kind and node of every statement of a file that takes more than one breath."""
    for node in ast.walk(tree):
        if isinstance(node, COMPREHENSIONS) and contains(node, COMPREHENSIONS):
            yield "comprehension in a comprehension", node
        elif isinstance(node, ast.Assign) and binds_many(node):
            yield "three names bound at once", node
        elif isinstance(node, ast.IfExp) and contains(node, (ast.IfExp,)):
            yield "conditional expression in another", node
        for statement in list_unreached(node):
            yield "statement that is never reached", statement


@pytest.fixture(scope="module")
def dense_lines(floor_trees: dict[str, dict[Path, ast.Module]]) -> list[tuple[str, str]]:
    return [
        (kind, f"{path}:{node.lineno}")  # type: ignore[attr-defined]
        for trees in floor_trees.values()
        for path, tree in trees.items()
        for kind, node in find_dense_nodes(tree)
    ]


@pytest.mark.parametrize("kind", CEILINGS)
def test_dense_lines_only_get_fewer(dense_lines, kind):
    counts = Counter(found for found, _ in dense_lines)
    places = [place for found, place in dense_lines if found == kind]
    assert counts[kind] <= CEILINGS[kind], "\n".join(places)
    assert counts[kind] == CEILINGS[kind], f"lower the ceiling of {kind!r} to {counts[kind]}"
