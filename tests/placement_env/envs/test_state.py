"""State of episodes against plain loops; only its owner writes it."""

import ast
from pathlib import Path

import numpy as np
import pytest

import placement_env
from placement_env.envs.state import State, coverage_gain

FOLDER = Path(placement_env.__file__).parent


def test_gains_and_episodes_of_a_state():
    rng = np.random.default_rng(0)
    bits = rng.random((7, 128)) < 0.3  # slots, places
    seen = np.ascontiguousarray(np.packbits(bits, axis=1).view(np.uint64).T)
    chosen = rng.random((20, 7)) < 0.3
    together, added = coverage_gain(seen, chosen)
    for row in range(20):
        covered = bits[chosen[row]].any(axis=0)
        assert together[row] == covered.sum()
        assert added[row].tolist() == [(bits[slot] & ~covered).sum() for slot in range(7)]
    assert not State(2, 3).ready
    with pytest.raises(ValueError, match="num_envs must be a whole number of at least 1, got 0"):
        State(0, 3)


@pytest.mark.parametrize("path", sorted(FOLDER.rglob("*.py")), ids=lambda path: path.stem)
def test_state_is_written_by_its_owner_alone(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        for target in targets:
            while isinstance(target, ast.Subscript):
                target = target.value
            owner = target.value if isinstance(target, ast.Attribute) else None
            name = owner.attr if isinstance(owner, ast.Attribute) else getattr(owner, "id", "")
            assert name != "state", f"{path.name}:{node.lineno} writes a state"  # type: ignore[attr-defined]
