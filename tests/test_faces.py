"""The faces of the packages: every name they offer loads, keeps its type, and a misspelt one is an
error for mypy."""

import ast
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FACES = ["toolkit", "models", "placement_env", "placement_env.search"]


def offered(face):
    """The names of a face's stub, by module below it; "" for modules of its own."""
    stub = ast.parse((ROOT / face.replace(".", "/") / "__init__.pyi").read_text())
    assert all(isinstance(node, ast.ImportFrom) and node.level == 1 for node in stub.body)
    names = [name for node in stub.body for name in node.names]
    assert all(name.asname == name.name for name in names), "import X as X, or mypy hides it"
    return [(node.module or "", name.name) for node in stub.body for name in node.names]


@pytest.mark.parametrize("face", FACES)
def test_every_name_loads_and_hides_no_module(face):
    package = importlib.import_module(face)
    names = [name for _, name in offered(face)]
    assert sorted(names) == package.__all__ == dir(package)
    assert len(set(names)) == len(names)
    for module, name in offered(face):
        assert getattr(package, name) is not None
        is_module = (ROOT / face.replace(".", "/") / name).with_suffix(".py").exists()
        assert is_module == (module == ""), f"{name} is a module too"
    with pytest.raises(AttributeError, match="lode_site"):
        _ = package.lode_site


@pytest.mark.parametrize(
    "path", [*(ROOT / "examples").glob("*.py"), ROOT / "README.md"], ids=lambda path: path.name
)
def test_examples_and_readme_import_from_the_faces(path):
    deeper = re.findall(
        r"^\s*(?:from|import) ((?:toolkit|models|placement_env)\.\S+)",
        path.read_text(),
        re.MULTILINE,
    )
    assert not deeper, f"offer what it needs in the face, in place of importing {deeper}"


def test_a_star_imports_all_names_of_coview():
    names: dict[str, object] = {}
    exec("from coview import *", names)
    assert {"load_site", "search", "make", "plan"} <= names.keys()


def test_a_bare_machine_can_import_the_faces():
    """None of the heavy packages loads before something of them is used."""
    heavy = ["open3d", "torch", "libsumo", "matplotlib", "stable_baselines3", "ortools"]
    code = (
        f"import sys, toolkit, models, placement_env; print([m for m in {heavy} if m in "
        "sys.modules])"
    )
    said = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert said.stdout.strip() == "[]"


def test_mypy_sees_through_the_faces(tmp_path):
    names = {face: [name for module, name in offered(face) if module] for face in FACES}
    lines = [
        f"from {face} import {name}\nreveal_type({name})" for face in FACES for name in names[face]
    ]
    (tmp_path / "sound.py").write_text("\n".join(lines))
    (tmp_path / "misspelt.py").write_text(
        "\n".join(f"from {face} import lode_site" for face in FACES)
    )
    mypy = [
        sys.executable,
        "-m",
        "mypy",
        "--config-file",
        str(ROOT / "pyproject.toml"),
        "--cache-dir",
        ".mypy_cache",
    ]
    files = [str(tmp_path / "sound.py"), str(tmp_path / "misspelt.py")]
    said = subprocess.run(
        [*mypy, *files], cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout
    revealed = re.findall(r'Revealed type is "(.*)"', said)
    assert len(revealed) == sum(map(len, names.values())), said
    assert not [kind for kind in revealed if kind == "Any"]
    for face in FACES:
        assert f'Module "{face}" has no attribute "lode_site"' in said
