"""The environments are known to Gymnasium whichever package is imported first; torch and Open3D stay unloaded."""

from __future__ import annotations

import subprocess
import sys

import pytest

KNOWN = "assert sum(name.startswith('coview/') for name in gymnasium.registry) == 3"
LIGHT = "import sys; assert not {'torch', 'open3d', 'libsumo'} & set(sys.modules)"


@pytest.mark.parametrize(
    "code",
    [
        f"import gymnasium, placement_env; {KNOWN}; {LIGHT}",
        f"import placement_env, gymnasium; {KNOWN}",
        f"import placement_env, gymnasium; placement_env.envs.registration.register(); {KNOWN}",
    ],
)
def test_either_order(code: str) -> None:
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("name", ["Select", "Subset", "Pose"])
def test_what_is_misspelt_is_told_when_made(name: str) -> None:
    import gymnasium

    with pytest.raises(TypeError, match="'frame'"):
        gymnasium.make(f"coview/Sensor{name}-v0", frame=3)
    with pytest.raises((ValueError, TypeError), match="surogate"):  # whichever checks first, we or beartype
        gymnasium.make(f"coview/Sensor{name}-v0", fidelity="surogate")
