"""Options of `coview evaluate`: what is scored, and by which rules."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from coview import arguments


@dataclass(frozen=True)
class Link:
    """Link from sensors to the centre."""

    codec: str = "paper"
    """Coding: paper counts 96 bits a point and 256 a box, range-images sends bytes, as scheme
    foreground does."""
    step: float = 0.02
    """Resolution of the distances in bytes (m): 0.02, 0.04, 0.08; foreground takes a coarser one,
    up to 0.32, for a message that would not fit one packet."""
    rate: float | None = None
    """Frame rate (Hz); prints each scheme's load on the link, its packets and their airtime, and
    gives times to --tracks of texts."""


@dataclass(frozen=True)
class Rules:
    """Rules of scoring."""

    schemes: tuple[str, ...] | None = None
    """Fusion schemes: early, late, hybrid, foreground; when left out, the first three at a
    known site."""
    sensors: tuple[str, ...] = ("all",)
    """Sensor sets, each a comma-separated list of numbers or names, or all."""
    classes: tuple[arguments.Label, ...] | None = None
    """Classes to score; those that the detector knows when left out."""
    iou: tuple[float, ...] | None = None
    """IoU thresholds; 0.7 0.8 0.9 for vehicle and heavy, 0.25 0.5 0.7 for cyclist and pedestrian
    when left out."""
    metric: Literal["3d", "bev"] = "3d"
    """IoU of volumes or of footprints."""
    protocol: Literal["exact", "published", "measured"] | None = None
    """Objects that count: exact, as the published code counts, or with a point (measured, usual
    without a site)."""
    breakdown: bool | None = None
    """Print AP by range and points, and in other protocols; usual without a known site."""
    radius: float | None = None
    """Distance (m) beyond which hybrid fusion shares points; the site's when left out."""
    timings: bool = False
    """Print median, 95th and 99th percentile of the milliseconds of each stage, by scheme."""
    similarity: tuple[float, ...] | None = None
    """Similarities from which a track and an object match, for MOTA, IDF1 and sAMOTA of --tracks;
    0.5 when left out."""
    link: Link = Link()


@dataclass(frozen=True)
class Subject:
    """Detector and sensors to score."""

    detector: str | None = None
    """Detector: voxelnet (the site's network, or general), cluster, general, a file of weights or
    in ONNX, or package.module:callable; +background drops what stands, +phases4 detects on four
    shifted grids, +bfloat16 in coarser numbers."""
    calibrate: str | None = None
    """Reference, as in coview calibrate, to find the sensors' poses by first, or together."""
    errors: str = "paper"
    """Error profile of sensors that measured images: paper (their own noise), surveyed, typical,
    glare, typical-clock, poor."""
    tracks: Path | None = None
    """Tracks to score instead of a detector: JSON or CSV of coview track, OpenLABEL, or KITTI's
    tracking text; a folder of such texts next to a folder of labels."""
