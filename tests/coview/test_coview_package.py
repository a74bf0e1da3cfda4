"""`import coview`: quick, and the same for people, type checkers and Python."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import pytest

import coview
from placement_env.setting import Setting

HEAVY = (
    "torch",
    "open3d",
    "numpy",
    "h5py",
    "matplotlib",
    "tyro",
    "gymnasium",
    "importlib.metadata",
)


def test_names_load_lazily_and_make_searches_and_environments():
    tree = ast.parse(Path(coview.__file__).read_text())
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    told = {str(alias.asname): str(node.module) for node in imports for alias in node.names}
    assert set(told) == set(dir(coview)) - {"__version__", "live", "make", "search"}
    for name, face in told.items():
        assert getattr(coview, name) is getattr(importlib.import_module(face), name)
    assert len(told) <= 25
    assert coview.__version__[0].isdigit()
    assert not hasattr(coview, "lode_site")
    code = f"import sys, coview; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
    objective = coview.Objective(Setting("tjunction", fidelity="table"))
    assert coview.search(objective, 2, method="exhaustive").best.subset
    with pytest.raises(ValueError, match=r"method must be one of portfolio, .*, got 'luck'"):
        coview.search(objective, 2, method="luck")
    env = coview.make(site="tjunction", fidelity="table", budget=2)
    assert env.unwrapped.spec.id == "coview/SensorSelect-v0"
    env.reset(seed=0)
    with pytest.raises(gym.error.Error):
        coview.make("SensorDream")
