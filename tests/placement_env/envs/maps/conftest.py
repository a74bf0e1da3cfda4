"""Junctions that are made up, as those that an environment prepares."""

from __future__ import annotations

from pathlib import Path

import pytest

from placement_env.envs.maps import map_select


@pytest.fixture
def junctions(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, made_up) -> Path:
    """A folder whose junctions are made up."""
    monkeypatch.setattr(
        map_select, "prepare", lambda seed, folder, *, frames, places, poses: made_up(seed, places, poses)
    )
    return tmp_path
