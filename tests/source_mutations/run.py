"""Changes the source of the rooms that carry figures and counts what no test notices.

`python tests/source_mutations/run.py 20` prints a table of rooms and every change that survived.
Each change is made in a copy of the tree, where the room's own tests run until one fails. A
survivor is a missing test, or a change that means the same.
"""

import argparse
import ast
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from queue import Queue

ROOT = Path(__file__).parents[2]
ANALYSIS, PLANNING, PORTFOLIO = (
    "placement_env/analysis",
    "placement_env/report/planning",
    "placement_env/search/portfolio",
)
ROOMS = (
    ANALYSIS,
    PLANNING,
    PORTFOLIO,
    "toolkit/detection/link",
    "toolkit/calibration",
    "toolkit/detection/metrics.py",
)
COMPARISONS = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
OPERATORS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.Pow: ast.Mult,
    ast.FloorDiv: ast.Mult,
}
PAIRS = (
    ("min", "max"),
    ("minimum", "maximum"),
    ("argmin", "argmax"),
    ("sum", "mean"),
    ("any", "all"),
    ("floor", "ceil"),
    ("zeros", "ones"),
    ("isnan", "isfinite"),
)
NAMES = {**dict(PAIRS), **{other: one for one, other in PAIRS}}
# words and declarations, not figures
SILENT = (ast.JoinedStr, ast.Raise, ast.Assert, ast.Import, ast.ImportFrom)
SKIPPED = ("annotation", "returns", "decorator_list")
CHECKS = ("strict", "dtype")  # keywords that no figure depends on
LONGEST = 600.0  # s that the tests of a room may take
Change = Callable[[], None]


@dataclass(frozen=True)
class Mutant:
    """One change of one file: its place, what it says, and the whole changed source."""

    path: str
    line: int
    change: str
    source: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}  {self.change}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mutants", type=int, nargs="?", default=20, help="of each room")
    parser.add_argument("--rooms", nargs="*", default=ROOMS, help="folders or files of the source")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--first",
        type=int,
        default=0,
        help="number of the first mutant, to go on where a run ended",
    )
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        copies = [copy_tree(Path(folder) / str(job)) for job in range(given.jobs)]
        for room in given.rooms:
            mutants = draw_mutants(room, given.first + given.mutants, given.seed)[given.first :]
            rows.append((room, len(mutants), run_mutants(room, mutants, copies)))
    print(f"{'room':36} mutants  killed  survivors")
    for room, count, left in [
        *rows,
        ("all", sum(row[1] for row in rows), sum(row[2] for row in rows)),
    ]:
        print(f"{room:36} {count:7} {count - left:7} {left:10}")


def draw_mutants(room: str, count: int, seed: int) -> list[Mutant]:
    """Draw different mutants of a room; with one seed a longer list begins with the shorter one."""
    start = ROOT / room
    paths = [start] if start.is_file() else sorted(start.glob("*.py"))
    texts = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in paths}
    every = [
        (path, number) for path, text in texts.items() for number in range(count_mutants(text))
    ]
    random.Random(f"{seed} {room}").shuffle(every)
    return [make_mutant(path, texts[path], number) for path, number in every[:count]]


def run_mutants(room: str, mutants: Sequence[Mutant], copies: Sequence[Path]) -> int:
    """Print and count the mutants that no test of the room notices. Raises RuntimeError if one
    fails unchanged."""
    start = time.monotonic()
    if not passes(copies[0], room, LONGEST):
        raise RuntimeError(f"the tests of {room} fail without any change: mend them first")
    limit = 30 + 4 * (time.monotonic() - start)
    free: Queue[Path] = Queue()
    for each in copies:
        free.put(each)

    def survives(mutant: Mutant) -> bool:
        copy = free.get()
        file = copy / mutant.path
        before = file.read_bytes()
        file.write_text(mutant.source, encoding="utf-8")
        try:
            left = passes(copy, room, limit, Path(mutant.path).stem)
        finally:
            file.write_bytes(before)
            free.put(copy)
        if left:
            print(mutant, flush=True)
        return left

    with ThreadPoolExecutor(len(copies)) as threads:
        return sum(threads.map(survives, mutants))


def passes(copy: Path, room: str, seconds: float, file: str = "") -> bool:
    """Run the tests of a room in a copy of the tree, those of the changed file first, examples in
    docstrings last."""
    tests = copy / "tests" / room
    found = (
        [tests.with_name(f"test_{tests.name}")] if tests.suffix else sorted(tests.glob("test_*.py"))
    )
    found.sort(key=lambda path: (path.stem == f"test_{tests.name}", path.stem != f"test_{file}"))
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-x",
        "-q",
        "-p",
        "no:cacheprovider",
        *map(str, [*found, copy / room]),
    ]
    environment = {
        **os.environ,
        "PYTHONPATH": str(copy),
        "OMP_NUM_THREADS": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    process = subprocess.Popen(
        command,
        cwd=copy,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        return process.wait(seconds) == 0
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        return False


def copy_tree(to: Path) -> Path:
    """Copy the files of the tree that git knows or would take."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    )
    for name in filter(None, listed.stdout.decode().split("\0")):
        if (ROOT / name).is_file():
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, to / name)
    return to


def count_mutants(text: str) -> int:
    """Count the mutants of a source."""
    return sum(1 for _ in _changes(ast.parse(text)))


def make_mutant(path: str, text: str, number: int) -> Mutant:
    """Make one mutant of a source, numbered from 0.

    >>> text = "if not a < 1: b = max(a, key=c)"
    >>> for k in range(count_mutants(text)):
    ...     print(make_mutant("", text, k).source.replace("\\n   ", ""))
    if not not a < 1: b = max(a, key=c)
    if not a <= 1: b = max(a, key=c)
    if not a < 0: b = max(a, key=c)
    if not a < 1: b = max(a)
    if not a < 1: b = min(a, key=c)
    """
    tree = ast.parse(text)
    node, change = next(islice(_changes(tree), number, None))
    before, line = ast.unparse(node), getattr(node, "lineno", 1)
    change()
    after = ast.unparse(node)
    same = next(
        (k for k, pair in enumerate(zip(before, after, strict=False)) if pair[0] != pair[1]),
        len(before),
    )
    line += before[:same].count("\n") if isinstance(node, ast.stmt) else 0
    said = (" ".join(words[max(0, same - 30) : same + 30].split()) for words in (before, after))
    where = "" if len(before) > 20 else f"  in  {text.splitlines()[line - 1].strip()}"
    return Mutant(path, line, " -> ".join(said) + where, ast.unparse(tree))


def _changes(node: ast.AST) -> Iterator[tuple[ast.AST, Change]]:
    """Walk a tree for changes, each with the node that shows it."""
    if isinstance(node, SILENT) or (isinstance(node, ast.keyword) and node.arg in CHECKS):
        return
    yield from ((node, change) for change in _changes_of(node))
    for name, value in ast.iter_fields(node):
        if name not in SKIPPED:
            for each in value if isinstance(value, list) else [value]:
                if isinstance(each, ast.AST):
                    yield from _changes(each)


def _changes_of(node: ast.AST) -> Iterator[Change]:
    def put(field: str, value: object) -> Change:
        return lambda: setattr(node, field, value)

    match node:
        case ast.Compare(ops=ops):
            for k, op in enumerate(ops):
                if type(op) in COMPARISONS:
                    yield put("ops", [*ops[:k], COMPARISONS[type(op)](), *ops[k + 1 :]])
        case ast.BinOp(op=op) | ast.AugAssign(op=op) if type(op) in OPERATORS:
            yield put("op", OPERATORS[type(op)]())
        case ast.BoolOp(op=op):
            yield put("op", ast.Or() if isinstance(op, ast.And) else ast.And())
        case ast.Constant(value=bool() as value):
            yield put("value", not value)
        case ast.Constant(value=int() | float() as value) if value in (0, 1):
            yield put("value", type(value)(1 - value))
        case ast.UnaryOp(op=op, operand=operand):  # twice is as good as dropped
            yield put("operand", ast.UnaryOp(op, operand))
        case ast.Name(id=name) if name in NAMES:
            yield put("id", NAMES[name])
        case ast.Attribute(attr=name) if name in NAMES:
            yield put("attr", NAMES[name])
        case ast.Call(keywords=[_, *_] as words):
            for k, each in enumerate(words):
                if each.arg not in (None, *CHECKS):
                    yield put("keywords", words[:k] + words[k + 1 :])
    for field in ("body", "orelse"):
        block = getattr(node, field, None)
        for k, each in enumerate(block if isinstance(block, list) else ()):
            if isinstance(block, list) and _removable(each):
                yield put(field, [*block[:k], ast.Pass(), *block[k + 1 :]])


def _removable(statement: ast.stmt) -> bool:
    if isinstance(statement, ast.Expr):
        return not isinstance(statement.value, ast.Constant)
    if isinstance(statement, ast.Assign):
        return all(
            isinstance(target, ast.Subscript | ast.Attribute) for target in statement.targets
        )
    return isinstance(statement, ast.AugAssign | ast.Raise | ast.Continue | ast.Break)


if __name__ == "__main__":
    main()
