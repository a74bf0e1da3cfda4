"""Record measured figures and write them into the documentation.

Benchmarks hand over what they measured; it is kept only if COVIEW_FIGURES names the machine:

    COVIEW_FIGURES=B python tests/benchmarks/toolkit/bench_boxes.py

`docs/figures.json` then holds the row with today's date, the commit and that letter, and the tables
of `docs/figures.md` are written from it. Results of commands are read from their JSON:

    COVIEW_FIGURES=B python tests/benchmarks/figures.py T-junction '`site`' evaluate.json

Without arguments the tables are only written again.
"""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[2] / "docs"
FIGURES = DOCS / "figures.json"
PAGE = DOCS / "figures.md"
SITE_TITLES = {"tjunction": "T-junction", "roundabout": "roundabout"}

Table = dict[str, Any]
Row = dict[str, Any]


def record(table: str, row: str, cells: Sequence[str], network: str = "–") -> None:
    """Keep one measured row of a table, replacing the row of the same name.

    Args:
        table: Name of a table in `docs/figures.json`.
        row: First cell, which names the row within its table.
        cells: The other cells, as shown.
        network: Network that took part, as the page names it; – for none.

    Raises:
        KeyError: No table has this name.
        ValueError: The number of cells differs from the table's columns.
    """
    machine = os.environ.get("COVIEW_FIGURES")
    if not machine:
        return
    tables = read_tables()
    if table not in tables:
        raise KeyError(f"docs/figures.json has no table {table!r}; it has {', '.join(tables)}")
    columns = tables[table]["columns"]
    if len(cells) + 1 != len(columns):
        raise ValueError(f"table {table} has {len(columns)} columns: {row!r} has {len(cells) + 1}")
    today = datetime.now(UTC)
    measured = {
        "cells": [row, *cells],
        "network": network,
        "date": f"{today.day} {today:%b %Y}",
        "commit": current_commit(),
        "machine": machine,
    }
    rows: list[Row] = tables[table]["rows"]
    names = [known["cells"][0] for known in rows]
    if row in names:
        rows[names.index(row)] = measured
    else:
        rows.append(measured)
    write_tables(tables)


def read_tables() -> dict[str, Table]:
    """Return every table of `docs/figures.json` by its name."""
    tables: dict[str, Table] = json.loads(FIGURES.read_text(encoding="utf-8"))
    return tables


def write_tables(tables: dict[str, Table]) -> None:
    """Write `docs/figures.json` and the tables of the page."""
    text = json.dumps(tables, indent=1, ensure_ascii=False) + "\n"
    FIGURES.write_text(text, encoding="utf-8")
    PAGE.write_text(render_page(PAGE.read_text(encoding="utf-8"), tables), encoding="utf-8")


def render_page(page: str, tables: dict[str, Table]) -> str:
    """Return the page with every table between its two marks written anew.

    Raises:
        ValueError: The page and the tables do not name the same ones.
    """
    shown = []
    lines: list[str] = []
    inside = False
    for line in page.split("\n"):
        if line.startswith("<!-- table "):
            name = line.removeprefix("<!-- table ").removesuffix(" -->")
            if name not in tables:
                raise ValueError(f"docs/figures.md shows a table {name!r} that was not measured")
            shown.append(name)
            lines += [line, *render_table(tables[name])]
            inside = True
        elif line == "<!-- end -->":
            inside = False
        if not inside:
            lines.append(line)
    hidden = [name for name in tables if name not in shown]
    if hidden:
        raise ValueError(f"docs/figures.md does not show {', '.join(hidden)}")
    return "\n".join(lines)


def render_table(table: Table) -> list[str]:
    """Return a table's lines in Markdown; what all rows share stands once, below it."""
    rows = table["rows"]
    networks = {row["network"] for row in rows}
    occasions = {_occasion(row) for row in rows}
    columns = list(table["columns"])
    if len(networks) > 1:
        columns.append("network")
    if len(occasions) > 1:
        columns.append("measured")
    lines = [_line(columns), "|" + "---|" * len(columns)]
    for row in rows:
        cells = list(row["cells"])
        if len(networks) > 1:
            cells.append(row["network"])
        if len(occasions) > 1:
            cells.append(_occasion(row))
        lines.append(_line(cells))
    shared = []
    if len(occasions) == 1:
        shared.append("Measured " + occasions.pop())
    if len(networks) == 1 and networks != {"–"}:
        shared.append("network " + networks.pop())
    if shared:
        caption = "; ".join(shared)
        lines += ["", caption[0].upper() + caption[1:] + "."]
    return ["", *lines, ""]


def _occasion(row: Row) -> str:
    return f"{row['date']}, {row['commit']}, {row['machine']}"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def current_commit() -> str:
    """Return the short name of the commit that is checked out."""
    command = ["git", "rev-parse", "--short=8", "HEAD"]
    answer = subprocess.run(command, capture_output=True, text=True, check=True, cwd=DOCS)
    return answer.stdout.strip()


def record_result(site: str, result: dict[str, Any], network: str) -> None:
    """Record the vehicles' rows of what `coview evaluate` or `coview stress` printed with --json.

    Args:
        site: Site as the page calls it.
        result: Parsed output of the command.
        network: Network as the page calls it.

    Raises:
        ValueError: Neither command prints such a result.
    """
    rows = [row for row in result.get("rows", ()) if row.get("label") == "vehicle"]
    if rows and "ap" in rows[0]:
        _record_schemes(site, rows, network)
    elif rows and rows[0].get("kind") == "mounting":
        _record_mounting(rows, network)
    elif rows and rows[0].get("kind") in ("delay", "loss"):
        _record_late_messages(rows, network)
    else:
        raise ValueError(
            "neither vehicles by scheme nor by mounting, delay or loss are in this result"
        )


def _record_schemes(site: str, rows: Sequence[Row], network: str) -> None:
    for scheme in dict.fromkeys(row["scheme"] for row in rows):
        of_scheme = [row for row in rows if row["scheme"] == scheme]
        share = "/".join(f"{row['ap']:.4f}" for row in of_scheme)
        kbit = f"{of_scheme[0]['kbit_per_sensor']:.2f}"
        record("schemes", f"{site}, {scheme}", [share, kbit], network)


def _record_mounting(rows: Sequence[Row], network: str) -> None:
    columns = read_tables()["mounting"]["columns"][1:]
    for level in dict.fromkeys(row["level"] for row in rows):
        judged = {row["scheme"]: row["judged"] for row in rows if row["level"] == level}
        cells = [_share_with_interval(judged[scheme]) for scheme in columns]
        record("mounting", level, cells, network)


def _record_late_messages(rows: Sequence[Row], network: str) -> None:
    """Record each delay and loss as messages arrive, next to the same with tracks."""
    judged = {f"{row['kind']} {row['level']}": row["judged"] for row in rows}
    for name, arrived in judged.items():
        tracked = judged.get(f"{name}, tracks")
        if tracked is not None:
            cells = [_share_with_interval(arrived), _share_with_interval(tracked)]
            record("late-messages", name, cells, network)


def _share_with_interval(judged: dict[str, Any]) -> str:
    if judged["low"] is None:
        return f"{judged['ap']:.3f}"
    return f"{judged['ap']:.3f} ({judged['low']:.3f}–{judged['high']:.3f})"


if __name__ == "__main__":
    if len(sys.argv) > 3:
        site_name, network_name, *files = sys.argv[1:]
        for file in files:
            record_result(site_name, json.loads(Path(file).read_text("utf-8")), network_name)
    write_tables(read_tables())
