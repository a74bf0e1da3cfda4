"""Every example, and what the README shows in Python, runs to its end and prints something."""

import re
import runpy
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "examples"
EXAMPLES = sorted([*FOLDER.glob("*.py"), *FOLDER.glob("*/__main__.py")])


# what they show is tested elsewhere; the others take what README and pages take
SLOW = ("02", "10")


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    "example",
    [
        pytest.param(path, marks=[pytest.mark.slow] * path.name.startswith(SLOW))
        for path in EXAMPLES
    ],
    ids=lambda path: str(path.relative_to(FOLDER)),
)
def test_example(example, capsys, tmp_path, work_in):
    work_in(tmp_path)
    runpy.run_path(str(example), run_name="__main__")
    assert capsys.readouterr().out.strip()


def test_readme(capsys, tmp_path, work_in):
    work_in(tmp_path)
    blocks = re.findall(
        r"```python\n(.*?)```",
        (Path(__file__).parents[1] / "README.md").read_text(),
        flags=re.DOTALL,
    )
    assert len(blocks) >= 2
    for block in blocks:
        exec(compile(block, "README.md", "exec"), {})
        assert capsys.readouterr().out.strip()
