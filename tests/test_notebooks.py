"""The documentation's notebooks: executed, small, without a path of the machine that ran them; they
run anew."""

import re
from importlib import import_module
from pathlib import Path

import nbformat
import pytest

FOLDER = Path(__file__).parents[1] / "docs" / "notebooks"
NOTEBOOKS = sorted(path.stem for path in FOLDER.glob("*.ipynb"))


def outputs(name):
    cells = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4).cells
    return [(cell, cell.outputs) for cell in cells if cell.cell_type == "code"]


def test_there_is_one_for_each_user_and_together_they_are_small():
    assert NOTEBOOKS == ["fuse-and-evaluate", "plan-a-junction", "search-and-train"]
    assert sum(path.stat().st_size for path in FOLDER.glob("*.ipynb")) < 1_500_000


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_they_were_executed_from_top_to_bottom_and_show_pictures(name):
    cells = outputs(name)
    assert [cell.execution_count for cell, _ in cells] == list(range(1, len(cells) + 1))
    shown = [each for _, some in cells for each in some]
    assert not any(each.output_type == "error" for each in shown)
    assert sum("image/png" in str(each.get("data", {})) for each in shown) >= 2
    text = "".join(each.get("text", "") for each in shown)
    assert not re.search(r"(?:^|\s)/\w+/|ipykernel", text)


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_they_run_anew(name, work_in, environment):
    work_in(FOLDER)
    environment(PYTHONPATH=str(FOLDER.parents[1]))
    notebook = import_module("execute").execute(name)
    assert all(cell.execution_count for cell in notebook.cells if cell.cell_type == "code")
