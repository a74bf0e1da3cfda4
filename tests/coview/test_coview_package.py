"""`import coview`: quick, complete, and the same for people, type checkers and Python."""

import ast
import subprocess
import sys
from pathlib import Path

import coview

HEAVY = ("torch", "open3d", "numpy", "h5py", "matplotlib", "tyro", "gymnasium")


def test_every_name_is_what_the_type_checker_is_told():
    tree = ast.parse(Path(coview.__file__).read_text())
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    told = {str(alias.asname): str(node.module) for node in imports for alias in node.names}
    assert set(told) == set(dir(coview)) - {"__version__"}
    for name, module in told.items():
        assert getattr(coview, name) is getattr(sys.modules[module], name)


def test_it_has_a_version_and_no_other_names():
    assert coview.__version__[0].isdigit()
    assert not hasattr(coview, "lode_site")


def test_nothing_heavy_loads_before_it_is_used():
    code = f"import sys, coview; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_files_of_the_command_line_stay_short():
    for path in Path(coview.__file__).parent.rglob("*.py"):
        assert len(path.read_text().splitlines()) <= 200, path
