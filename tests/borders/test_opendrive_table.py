"""The table of OpenDRIVE in the docs against what the code reads of a map."""

import ast
import re
from pathlib import Path

import pytest

from toolkit.sites.opendrive import lane_rules

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "reference" / "opendrive.md"
READERS = sorted(
    path
    for path in (ROOT / "toolkit" / "sites" / "opendrive").glob("*.py")
    if path.name != "lane_shapes.py"  # which reads networks
)
MARKS = {"netconvert", "ours", "note", "none"}
SEARCHES = ("find", "findall", "findtext", "iter", "iterfind")
OURS = {"end", "start", "whole", "coview"}  # words of the code that are no names of the standard


def rows() -> list[list[str]]:
    """Cells of the tables whose third column says who reads an element."""
    lines = [line for line in PAGE.read_text().splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [row for row in cells if len(row) == 4 and row[2] not in ("by", "---")]


def names(text: str) -> set[str]:
    """Names of elements or attributes in a cell."""
    return {word for code in re.findall(r"`([^`]*)`", text) for word in re.findall(r"\w+", code)}


def read_names() -> tuple[set[str], set[str]]:
    """Elements that the code looks for, and attributes that it takes."""
    elements: set[str] = set()
    attributes: set[str] = set()
    for reader in READERS:
        for node in ast.walk(ast.parse(reader.read_text())):
            if not isinstance(node, ast.Call):
                continue
            texts = [
                a.value
                for a in node.args
                if isinstance(a, ast.Constant) and isinstance(a.value, str)
            ]
            called = (
                node.func.attr
                if isinstance(node.func, ast.Attribute)
                else getattr(node.func, "id", "")
            )
            if called in SEARCHES:
                elements |= {part for text in texts for part in re.findall(r"\w+", text)}
            elif called in ("get", "read_number"):
                attributes |= set(texts[:1])
    return elements, attributes


def test_every_row_is_marked():
    assert len(rows()) > 60
    assert {row[2] for row in rows()} == MARKS


def test_what_the_code_reads_is_in_the_table():
    elements, attributes = read_names()
    read = [row for row in rows() if row[2] != "none"]
    listed = set().union(*(names(row[0]) | names(row[1]) | names(row[3]) for row in read))
    assert {"laneSection", "superelevation", "access"} <= elements
    assert elements - listed - OURS == set()
    assert {"singleSide", "pRange", "rule"} <= attributes
    unknown = {name for name in attributes - listed - OURS if re.fullmatch(r"[a-z]\w*", name)}
    assert unknown == set()


@pytest.mark.parametrize("kind", sorted(lane_rules.USERS))
def test_types_of_lanes_are_in_the_table(kind):
    page = PAGE.read_text()
    types = page[page.index("| type of lane | users |") : page.index("## Junctions")]
    assert f"`{kind}`" in types


def test_notes_are_in_the_code():
    """A row marked as a note has its words in the code."""
    code = "".join(reader.read_text() for reader in READERS)
    said = {
        "crossSectionSurface": "cross sections of strips are not read",
        "CRG": "surfaces in OpenCRG files are not read",
        "height": "heights of lanes beyond",
        "rule": "rules of lanes in words are not read",
        "roadMark": "lanes may be left where road marks forbid it",
        "elementS": "roads that branch off within another road",
        "dynamicLaneType": "stay as the map describes them",
        "mainRoad": "virtual junctions are left out",
        "predecessor": "virtual junctions are left out",
        "priority": "junctions have priorities, which are not read",
        "roadSection": "crossing junctions are left out",
        "elevationGrid": "junctions have a grid of heights",
        "tunnel": "tunnels have no walls and roof",
    }
    for row in rows():
        if row[2] == "note":
            mine = names(row[0].split("/")[-1]) | names(row[0]) | names(row[1])
            assert any(text in code for key, text in said.items() if key in mine), row
