"""The faces of the packages: every name they offer loads, keeps its type, and a misspelt one is an error for mypy."""

import ast
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FACES = ["toolkit", "models", "placement_env", "placement_env.search"]
TORN = "A name of a face is in the runtime table but not under TYPE_CHECKING, or the other way round"


def tree(face):
    return ast.parse((ROOT / face.replace(".", "/") / "__init__.py").read_text())


def typed(face):
    """The names imported under TYPE_CHECKING, by module below the face."""
    block = next(n for n in tree(face).body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING")
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    assert len(imports) == len(block.body)
    assert all(name.asname == name.name for node in imports for name in node.names), "import X as X, or mypy hides it"
    return {str(node.module).removeprefix(f"{face}."): tuple(name.name for name in node.names) for node in imports}


def lazy(face):
    """The table that `lazily` gets."""
    calls = (node for node in ast.walk(tree(face)) if isinstance(node, ast.Call))
    call = next(call for call in calls if ast.unparse(call.func) == "lazily")
    return ast.literal_eval(call.args[1])


@pytest.mark.parametrize("face", FACES)
def test_runtime_and_types_agree(face):
    assert typed(face) == lazy(face), TORN


@pytest.mark.parametrize("face", FACES)
def test_every_name_loads_and_hides_no_module(face):
    package = importlib.import_module(face)
    offered = [name for names in lazy(face).values() for name in names]
    assert sorted(offered) == package.__all__ == dir(package)
    assert len(set(offered)) == len(offered)
    for name in offered:
        assert getattr(package, name) is not None
        assert not (ROOT / face.replace(".", "/") / name).with_suffix(".py").exists(), f"{name} is a module too"
    with pytest.raises(AttributeError, match="has no attribute 'lode_site'"):
        _ = package.lode_site


@pytest.mark.parametrize("path", [*(ROOT / "examples").glob("*.py"), ROOT / "README.md"], ids=lambda path: path.name)
def test_examples_and_readme_import_from_the_faces(path):
    deeper = re.findall(r"^\s*(?:from|import) ((?:toolkit|models|placement_env)\.\S+)", path.read_text(), re.MULTILINE)
    assert not deeper, f"offer what it needs in the face, in place of importing {deeper}"


def test_a_bare_machine_can_import_the_faces():
    """None of the heavy packages loads before something of them is used."""
    heavy = ["open3d", "torch", "libsumo", "matplotlib", "stable_baselines3", "ortools"]
    code = f"import sys, toolkit, models, placement_env; print([m for m in {heavy} if m in sys.modules])"
    said = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"


def test_mypy_sees_through_the_faces(tmp_path):
    names = {face: [name for names in lazy(face).values() for name in names] for face in FACES}
    lines = [f"from {face} import {name}\nreveal_type({name})" for face in FACES for name in names[face]]
    (tmp_path / "sound.py").write_text("\n".join(lines))
    (tmp_path / "misspelt.py").write_text("\n".join(f"from {face} import lode_site" for face in FACES))
    mypy = [sys.executable, "-m", "mypy", "--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", ".mypy_cache"]
    files = [str(tmp_path / "sound.py"), str(tmp_path / "misspelt.py")]
    said = subprocess.run([*mypy, *files], cwd=ROOT, capture_output=True, text=True, check=False).stdout
    revealed = re.findall(r'Revealed type is "(.*)"', said)
    assert len(revealed) == sum(map(len, names.values())), said
    assert not [kind for kind in revealed if kind == "Any"]
    for face in FACES:
        assert f'Module "{face}" has no attribute "lode_site"' in said
