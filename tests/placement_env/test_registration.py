"""The environments are known to Gymnasium whichever package is imported first; without it nothing of it is imported."""

from __future__ import annotations

import subprocess
import sys

import pytest

BOTH = "assert sum(name.startswith('coview/') for name in gymnasium.registry) == 3"


@pytest.mark.parametrize(
    "code",
    [
        f"import gymnasium; register_with_gymnasium(); {BOTH}",
        f"register_with_gymnasium(); register_with_gymnasium(); import gymnasium; {BOTH}",
        "import sys; register_with_gymnasium(); assert 'gymnasium' not in sys.modules",
    ],
)
def test_either_order(code: str) -> None:
    start = "from placement_env.registration import register_with_gymnasium; "
    subprocess.run([sys.executable, "-c", start + code], check=True)
