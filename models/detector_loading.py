"""Detectors by name of shipped weights or path, for the weights' area or another one."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import SupportsFloat

import torch

from models.config import SHIPPED
from models.detector import VoxelNetDetector
from models.network.voxelnet import VoxelNet
from models.weight_files import load_weights
from models.wide_detector import WideVoxelNetDetector, is_wide
from toolkit.sites.site import PlaceMismatch, check_area


def load_detector(
    name: str | Path,
    *,
    site: str | None = None,
    area: Iterable[SupportsFloat] | None = None,
    device: str | torch.device = "cpu",
    score_threshold: float | None = None,
    nms_threshold: float = 0.1,
) -> VoxelNetDetector:
    """Load a detector by shipped name ("tjunction", "roundabout", "general") or path of its
    weights.

    site: the site that the weights must be for, None for any. area: xmin ymin xmax ymax (m, world
    frame) of detection, None for the weights' area; weights of one site keep their area, general
    ones fit any. score_threshold: lowest score of a detection, None for the weights' thresholds.
    Raises FileNotFoundError for unknown weights, ValueError if they are damaged or for another
    place.
    """
    network, header = load_weights(weights_file(name))
    trained_for = header.site or "general"
    if site is not None and trained_for not in (site, "general"):
        raise ValueError(
            f"{name} holds weights for {trained_for!r}, not for {site!r}: take {site!r} or "
            "'general'"
        )
    make_detector: Callable[..., VoxelNetDetector] = partial(VoxelNetDetector, network)
    if area is not None:
        xmin, ymin, xmax, ymax = check_area([float(side) for side in area]).tolist()
        sides = (xmin, ymin, xmax, ymax)
        if is_wide(sides, network.config) and goes_anywhere(network, trained_for):
            make_detector = partial(WideVoxelNetDetector, network, sides)
        else:
            make_detector = partial(VoxelNetDetector, relocate(network, sides, trained_for))
    detector = make_detector(
        device=device, score_threshold=score_threshold, nms_threshold=nms_threshold
    )
    detector.name = str(name)
    return detector


def load_site_detector(site: str, area: Iterable[SupportsFloat]) -> VoxelNetDetector:
    """Load the network shipped for a site, or the general one. area: xmin ymin xmax ymax, m, world
    frame."""
    is_shipped = (SHIPPED / f"{site}.safetensors").exists()
    return load_detector(site if is_shipped else "general", area=area)


def goes_anywhere(network: VoxelNet, trained_for: str) -> bool:
    """True if a network fits any area.

    trained_for: site of its weights' header, or "general".
    """
    return trained_for == "general" and network.config.point_features == "local"


def relocate(
    network: VoxelNet, area: tuple[float, float, float, float], trained_for: str
) -> VoxelNet:
    """Network with the same weights on another area (xmin ymin xmax ymax, m).

    trained_for: site of its weights' header, or "general". Raises PlaceMismatch for weights of only
    one area."""
    config = network.config
    if area == config.area:
        return network
    if not goes_anywhere(network, trained_for):
        trained_area = " ".join(f"{side:g}" for side in config.area)
        requested_area = " ".join(f"{side:g}" for side in area)
        remedy = f"give that area (--area {trained_area}), or take detector general"
        raise PlaceMismatch(
            f"these weights are for the area {trained_area} of {trained_for!r} alone, got "
            f"{requested_area}: {remedy}"
        )
    relocated = VoxelNet(replace(config, area=area))
    relocated.load_state_dict(network.state_dict())
    return relocated


def weights_file(name: str | Path) -> Path:
    """Path of shipped weights by name, or the path itself. Raises FileNotFoundError for an unknown
    name."""
    path = Path(name)
    if path.suffix in (".safetensors", ".onnx"):
        return path
    shipped = SHIPPED / f"{name}.safetensors"
    if not shipped.exists():
        names = ", ".join(sorted(file.stem for file in SHIPPED.glob("*.safetensors"))) or "none yet"
        raise FileNotFoundError(
            f"no weights named {str(name)!r}; shipped: {names}; or give a path to a .safetensors"
        )
    return shipped
