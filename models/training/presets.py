"""Presets: everything that decides how a network is trained, and which network for which area."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from models.config import VoxelNetConfig, kinds_of, road_users
from models.training.packed import PackedFrames
from models.training.samples import SampleRecipe

WINDOW = 40.0  # m; networks that know no absolute coordinates learn on windows of at most this side
ANYWHERE = (-WINDOW / 2, -WINDOW / 2, WINDOW / 2, WINDOW / 2)


@dataclass(frozen=True)
class Preset:
    """Everything that decides how a network is trained, beside the network and the data."""

    epochs: float = 4.0
    batch: int = 4
    optimiser: Literal["adamw", "sgd"] = "adamw"
    learning_rate: float = 3e-3
    weight_decay: float = 0.01
    schedule: Literal["one-cycle", "step"] = "one-cycle"
    loss: Literal["quality", "published"] = "quality"
    examples: SampleRecipe = field(default_factory=SampleRecipe)
    seed: int = 0


PRESETS = {
    "fast": Preset(),
    "paper": Preset(
        epochs=30.0, batch=1, optimiser="sgd", learning_rate=1e-3, weight_decay=1e-4, schedule="step", loss="published",
        examples=SampleRecipe(subsets=0.0, augmentation="object", positive=0.6, negative=0.6, sampled=256, seen=0),
    ),
    "general": Preset(examples=SampleRecipe(augmentation="scene", errors=0.4, thinned=0.3, tilted=0.3, elsewhere=0.2)),
    "varied": Preset(examples=SampleRecipe(errors=0.4, thinned=0.2, tilted=0.3, elsewhere=0.2)),
}  # fmt: skip


def config_for(
    area: tuple[float, float, float, float],
    preset: str,
    size: str = "light",
    classes: Sequence[str] = ("vehicle",),
) -> VoxelNetConfig:
    """The network a preset trains for an area: light or published in size, with the head its loss needs, for vehicles
    or for several classes.

    The light one knows no absolute coordinates, so it learns on a `window` of the area;
    `models.detector.relocated` puts what it learned on all of it.
    """
    quality = {"head": "quality", "anchor_z": 0.8, "quality_power": 1.0, "averaging": 0.75}
    published = {"head": "published", "anchor_z": 1.6, "quality_power": 0.0, "averaging": 0.0}
    head: dict[str, Any] = dict(published if PRESETS[preset].loss == "published" else quality)
    if tuple(classes) != ("vehicle",):
        head |= road_users(kinds_of(classes))
    if size == "light":
        return VoxelNetConfig.light(window(area), **head)
    voxel = (0.4, 0.4, 0.4) if max(area[2] - area[0], area[3] - area[1]) > 80 else (0.2, 0.2, 0.4)
    return VoxelNetConfig(area=area, voxel_size=voxel, **head)


def window(area: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """The middle of an area (xmin ymin xmax ymax, m), at most `WINDOW` wide.

    >>> window((-40.0, -20.0, 40.0, 10.0))
    (-20.0, -20.0, 20.0, 10.0)
    """
    xmin, ymin, xmax, ymax = area
    x, y = max(0.0, xmax - xmin - WINDOW) / 2, max(0.0, ymax - ymin - WINDOW) / 2
    return xmin + x, ymin + y, xmax - x, ymax - y


def check_fit(config: VoxelNetConfig, preset: Preset) -> None:
    """Raise ValueError where a preset's loss is for another head, or it cannot train anything."""
    if config.head != preset.loss:
        raise ValueError(f"the {preset.loss} loss trains a network with that head, got head {config.head!r}")
    if len(config.labels) > 1 and not config.kinds:
        raise ValueError(f"several labels need anchors of their own to be trained, got {config.labels}: give kinds")
    if preset.batch < 1 or not preset.epochs > 0:
        raise ValueError(f"need a batch of at least 1 and epochs above 0, got {preset.batch} and {preset.epochs}")


def area_for(preset: str, data: Path) -> tuple[float, float, float, float]:
    """The area to train: any, as large as a window, for `general`, else the one all frames of the data share.

    Raises ValueError where they share none.
    """
    if preset == "general":
        return ANYWHERE
    areas = {rig.area for rig in PackedFrames(data).rigs}
    if len(areas) > 1:
        raise ValueError(f"{data} holds {len(areas)} different areas: give a site, or general")
    return next(iter(areas))
