"""The environments are known to Gymnasium whichever package is imported first; heavy packages stay
unloaded."""

import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

KNOWN = "assert sum(name.startswith('coview/') for name in gymnasium.registry) == 3"
LIGHT = "import sys; assert not {'torch', 'open3d', 'libsumo'} & set(sys.modules)"
ROOT = Path(__file__).parents[3]


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    "code",
    [
        *(
            f"import gymnasium, placement_env; {KNOWN}; {LIGHT}",
            f"import placement_env, gymnasium; {KNOWN}; {LIGHT}",
        ),
        f"import placement_env; import gymnasium.envs.registration, gymnasium; {KNOWN}",
        (
            "import placement_env, importlib.util as u; u.find_spec('gymnasium'); import "
            f"gymnasium; {KNOWN}"
        ),
        f"import placement_env, gymnasium; placement_env.envs.registration.register_environments(); {KNOWN}",
        (
            "import placement_env, sys; assert not {'gymnasium', 'matplotlib', 'numpy'} & "
            "set(sys.modules)"
        ),
        (
            "import placement_env, gymnasium, importlib; importlib.reload(gymnasium); assert "
            "gymnasium.__loader__.get_data"
        ),
        (
            "import gymnasium; gymnasium.make('placement_env:coview/SensorSelect-v0', "
            "fidelity='table').reset()"
        ),
        (
            "import gymnasium; gymnasium.make_vec('placement_env:coview/SensorSubset-v0', 2, "
            "fidelity='table').reset()"
        ),
    ],
)
def test_either_order(code: str) -> None:
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_the_entry_point_registers_or_says_what_is_missing():
    """Gymnasium before 1.0, and tools that list environments, read the group; Gymnasium 1 reads no
    entry points."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    ((name, value),) = project["entry-points"]["gymnasium.envs"].items()
    assert name == "coview"
    EntryPoint(name, value, "gymnasium.envs").load()()
    import gymnasium

    assert sum(known.startswith("coview/") for known in gymnasium.registry) == 3
    code = """
import sys
sys.modules["gymnasium"] = None
from placement_env.envs.registration import register_environments
try:
    register_environments()
except ImportError as error:
    assert "coview[rl]" in str(error)
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
