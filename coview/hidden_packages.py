"""Whether a file of the user's hides a package of ours: Python takes the first `models` that it comes upon."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

PACKAGES = ("toolkit", "models", "placement_env")


def refuse_hidden_packages() -> None:
    """Raise ValueError, which names the file, where a package of ours is not the one beside this one."""
    home = Path(__file__).resolve().parents[1]
    for name in PACKAGES:
        spec = find_spec(name)
        places = [] if spec is None else [spec.origin, *(spec.submodule_search_locations or ())]
        place = next((Path(each).resolve() for each in places if each), None)
        if place is None:
            raise ValueError(f"{name}, a part of coview, is not installed: install coview again")
        if not place.is_relative_to(home / name):
            raise ValueError(
                f"{place} hides {name}, a part of coview: rename it, or run coview from another folder and without it "
                "in PYTHONPATH"
            )
