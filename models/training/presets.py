"""Presets by name, and the area and network that each preset trains."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from models.config import VoxelNetConfig, road_users, select_anchors
from models.training.packed import Area, PackedFrames
from models.training.preset import Preset
from models.training.samples import SampleRecipe

WINDOW_M = 40.0  # largest side of the windows for networks without absolute coordinates
ANYWHERE = (-WINDOW_M / 2, -WINDOW_M / 2, WINDOW_M / 2, WINDOW_M / 2)
_OBJECTS = SampleRecipe(
    subsets=0.0, augmentation="object", positive=0.6, negative=0.6, sampled=256, seen=0
)
_PAPER = Preset(optimiser="sgd", schedule="step", loss="published", examples=_OBJECTS)
PRESETS = {
    "fast": Preset(),
    "paper": replace(_PAPER, epochs=30.0, batch=1, learning_rate=1e-3, weight_decay=1e-4),
    "general": Preset(
        examples=SampleRecipe(
            augmentation="scene", errors=0.4, thinned=0.3, tilted=0.3, elsewhere=0.2
        )
    ),
    "varied": Preset(examples=SampleRecipe(errors=0.4, thinned=0.2, tilted=0.3, elsewhere=0.2)),
}


def make_config(
    area: Area, preset: str, size: str = "light", classes: Sequence[str] = ("vehicle",)
) -> VoxelNetConfig:
    """Configure the network that a preset trains for an area, light or published in size.

    The light one has no absolute coordinates, so it learns on a `window` of the area;
    `models.detector_loading.relocate` puts the result on the whole area.
    """
    head: dict[str, Any] = {
        "head": "quality",
        "anchor_z": 0.8,
        "quality_power": 1.0,
        "averaging": 0.75,
    }
    if PRESETS[preset].loss == "published":
        head = {"head": "published", "anchor_z": 1.6, "quality_power": 0.0, "averaging": 0.0}
    if tuple(classes) != ("vehicle",):
        head |= road_users(select_anchors(classes))
    if size == "light":
        return VoxelNetConfig.light(window(area), **head)
    is_large = max(area[2] - area[0], area[3] - area[1]) > 80  # m, the longer side
    voxel = (0.4, 0.4, 0.4) if is_large else (0.2, 0.2, 0.4)
    return VoxelNetConfig(area=area, voxel_size=voxel, **head)


def window(area: Area) -> Area:
    """Return the middle of an area (xmin ymin xmax ymax, m), at most `WINDOW_M` wide."""
    xmin, ymin, xmax, ymax = area
    x = max(0.0, xmax - xmin - WINDOW_M) / 2
    y = max(0.0, ymax - ymin - WINDOW_M) / 2
    return xmin + x, ymin + y, xmax - x, ymax - y


def choose_area(preset: str, data: Path) -> Area:
    """Return a window of any place for `general`, otherwise the area of all frames.

    Raises ValueError if the areas differ.
    """
    if preset == "general":
        return ANYWHERE
    areas = {rig.area for rig in PackedFrames(data).rigs}
    if len(areas) > 1:
        raise ValueError(f"{data} holds {len(areas)} different areas: give a site, or general")
    return next(iter(areas))
