"""Checkpoints of the paper's authors, checked and run on its two sites.

A `checkpoint_*.pth` of the paper's code uses CARLA's left-handed map, relative to a reference
point. This module keeps those axes, and turns clouds on their way in and boxes on their way out.
"""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from models.config import VoxelNetConfig
from models.network.candidates import MAX_CLOUD_CANDIDATES, candidates, suppress_boxes
from models.network.grid import anchors, voxelise
from models.network.sparse import SparseVoxelNet
from models.network.voxelnet import Prediction, VoxelNet
from models.weight_files import check_tensors, digest_detector, digest_tensors, load_tensors
from toolkit.arrays import BoxRows, Float32, Float64, Points
from toolkit.boxes import nms
from toolkit.objects import Detections

REFERENCE = {"tjunction": (84.0, 156.0), "roundabout": (0.0, 0.0)}  # CARLA x, y
# xmin ymin xmax ymax (m), relative to the reference
AREA = {"tjunction": (0.0, 0.0, 40.0, 80.0), "roundabout": (-48.0, -48.0, 48.0, 48.0)}

PROPOSAL_IOU = 0.3
MAX_PROPOSALS = 300
Decoding = Literal["exact", "published"]
_UP_LAST = [0, 2, 1]  # their x, up, y as x, y, z
_LAYER = ("conv1", "bn1")
# published names of tensors, by the groups of a pattern of the names here
_NAMES: tuple[tuple[str, Callable[..., str]], ...] = (
    (r"features\.layers\.0\.linear", lambda: "feature_learnig.vfe1.fcn1.conv1"),
    (r"features\.layers\.0\.norm", lambda: "feature_learnig.vfe1.fcn1.bn1"),
    (r"features\.layers\.1\.linear", lambda: "feature_learnig.fcn1.conv1"),
    (r"features\.layers\.1\.norm", lambda: "feature_learnig.fcn1.bn1"),
    (r"middle\.layers\.(\d)\.(\d)", lambda layer, kind: f"conv3d.conv{layer + 1}.{_LAYER[kind]}"),
    (
        r"rpn\.blocks\.(\d)\.(\d)\.(\d)",
        lambda block, k, kind: f"_rpn.conv{block + 1}_{k + 1}.{_LAYER[kind]}",
    ),
    (r"rpn\.upsample\.(\d)", lambda block: f"_rpn.deconv{3 - block}"),
    (r"head\.conv3x3", lambda: "_rpn.rpn_head.conv3x3"),
    (r"head\.classes", lambda: "_rpn.rpn_head.conv_cls"),
    (r"head\.residuals", lambda: "_rpn.rpn_head.conv_loc"),
)


def load_published(
    path: str | Path, site: str, *, decoding: Decoding = "exact", device: str | torch.device = "cpu"
) -> "PublishedDetector":
    """Load the detector of a published checkpoint for "tjunction" or "roundabout".

    decoding: "exact" to suppress overlapping boxes by their footprints, "published" to do before
    that what the published code does. No code of the file is executed. Raises FileNotFoundError,
    and ValueError for any other file.
    """
    if site not in REFERENCE:
        raise ValueError(f"the published networks are for {' and '.join(REFERENCE)}, got {site!r}")
    network = VoxelNet(replace(VoxelNetConfig.from_paper(site), area=AREA[site]))
    checkpoint = load_tensors(path)
    weights = checkpoint.get("state_dict") if isinstance(checkpoint, dict) else None
    if not isinstance(weights, dict) or not all(
        isinstance(tensor, Tensor) for tensor in weights.values()
    ):
        raise ValueError(
            f"{path} has no state_dict of tensors: is it a checkpoint_*.pth of the published code?"
        )
    # parallel training adds a prefix
    tensors = {str(name).removeprefix("module."): tensor for name, tensor in weights.items()}
    network.load_state_dict(from_published(tensors, network, path))
    return PublishedDetector(network.eval(), site, decoding=decoding, device=device)


class PublishedDetector:
    """Detector of a published network: points (n, 3) in, `Detections` out, in the site's frame, m.

    decoding: "exact" keeps scores above 0.1 and suppresses by a footprint IoU of 0.1. "published"
    first does the same as the published code: of the 2000 best anchors, boxes whose upright
    rectangles overlap by more than 0.3 are suppressed, and the 300 best stay.
    """

    def __init__(
        self,
        network: VoxelNet,
        site: str,
        *,
        decoding: Decoding = "exact",
        device: str | torch.device = "cpu",
        score_threshold: float = 0.1,
        nms_threshold: float = 0.1,
    ) -> None:
        """Fold the batch norm of a network with published weights into its layers.

        site: name of the site whose points it takes; decoding: "exact" suppresses overlapping
        boxes by their footprints, "published" first drops boxes as the published code does. Raises
        ValueError for another decoding."""
        if decoding not in ("exact", "published"):
            raise ValueError(f'decoding must be "exact" or "published", got {decoding!r}')
        self.site = site
        self.decoding = decoding
        self.config = network.config
        self.score_threshold = score_threshold
        self.nms_threshold = nms_threshold
        self.device = torch.device(device)
        self._weights = digest_tensors(network.state_dict())
        self.network = SparseVoxelNet(network).to(self.device)
        self.anchors = anchors(self.config).to(self.device)

    @property
    def digest(self) -> str:
        """SHA-256 of weights, configuration, site, decoding and thresholds."""
        settings = self.site, self.decoding, self.score_threshold, self.nms_threshold
        return digest_detector(self._weights, self.config.to_dict(), *settings)

    def head(
        self, points: Points, *, frame: Literal["site", "carla"] = "site"
    ) -> tuple[Float32[Tensor, "1 4 H W"], Float32[Tensor, "1 14 H W"]]:
        """Raw maps with channels 2 · anchor + {background, vehicle}, and 7 · anchor + residual.

        points: in the site's frame, or (x, -y, z) of CARLA's map. H is along CARLA's x, W along its
        y.
        """
        cloud = to_network(np.asarray(points, np.float32), self.site, frame)
        maps = self.network(voxelise(torch.from_numpy(cloud).to(self.device), self.config))
        return maps.class_logits.contiguous(), maps.residuals.contiguous()

    def __call__(self, points: Points, /) -> Detections:
        """Detections of one cloud (x y z in the site's frame, m)."""
        class_logits, residuals = self.head(points)
        # two anchors with seven residuals each, put into this project's order: x, y, z, then the
        # others
        channel_order = [7 * anchor + k for anchor in range(2) for k in (*_UP_LAST, 3, 4, 5, 6)]
        prediction = Prediction(
            class_logits=class_logits,
            residuals=residuals[:, torch.tensor(channel_order, device=self.device)],
        )
        thresholds = (self.score_threshold,)
        ((boxes, scores),) = candidates(prediction, self.anchors, self.config, thresholds)
        if self.decoding == "published":
            kept_rows = proposals(boxes.double().cpu().numpy(), scores[:, 0].double().cpu().numpy())
            boxes = boxes[kept_rows]
            scores = scores[kept_rows]
        detections = suppress_boxes(boxes, scores, self.config, self.nms_threshold)
        return Detections(
            from_network(detections.boxes, self.site), detections.scores, detections.labels
        )


def proposals(boxes: BoxRows, scores: Float64[np.ndarray, " n"]) -> np.ndarray:
    """Rows of boxes that survive the published proposal step, best first.

    It compares upright rectangles: the bounds of the footprints along x and y. boxes: x, y, z,
    length, width, height (m), yaw (rad); scores: one of each box.
    """
    best_rows = np.argsort(-scores, kind="stable")[:MAX_CLOUD_CANDIDATES]
    length = boxes[best_rows, 3]
    width = boxes[best_rows, 4]
    yaw = boxes[best_rows, 6]
    cos = np.abs(np.cos(yaw))
    sin = np.abs(np.sin(yaw))
    bounds = boxes[best_rows].copy()
    bounds[:, 3] = length * cos + width * sin
    bounds[:, 4] = width * cos + length * sin
    bounds[:, 6] = 0.0
    return best_rows[nms(bounds, scores[best_rows], PROPOSAL_IOU)[:MAX_PROPOSALS]]


def to_network(
    points: Float32[np.ndarray, "n 3"], site: str, frame: str = "site"
) -> Float32[np.ndarray, "n 3"]:
    """Points in the network's frame: CARLA's axes, relative to `REFERENCE`, m.

    points: in the site's frame, or with frame="carla" (x, -y, z) of CARLA's map.
    """
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must have shape (n, 3), got {points.shape}")
    x, y, z = points.T
    rx, ry = np.array(REFERENCE[site], np.float32)  # CARLA's x and y (m)
    if frame == "carla":
        return np.stack((x - rx, -y - ry, z), 1)
    if frame != "site":
        raise ValueError(f'frame must be "site" or "carla", got {frame!r}')
    # the site's x is 196 - CARLA's y, its y is 104 - CARLA's x; the network counts CARLA's x and y
    # from the reference point
    if site == "tjunction":
        return np.stack((np.float32(104 - rx) - y, np.float32(196 - ry) - x, z), 1)
    return np.stack((x, -y, z), 1)


def from_network(boxes: BoxRows, site: str) -> BoxRows:
    """Boxes of the network in the site's frame; the inverse of `to_network`.

    boxes: x, y, z, length, width, height (m), yaw (rad) in the network's frame."""
    x, y = boxes[:, :2].T
    yaw = boxes[:, 6]
    site_boxes = boxes.copy()
    if site == "tjunction":  # the site's x is 196 - CARLA's y, its y is 104 - CARLA's x
        rx, ry = REFERENCE[site]
        site_boxes[:, 0] = 196 - ry - y
        site_boxes[:, 1] = 104 - rx - x
        site_boxes[:, 6] = -np.pi / 2 - yaw
    else:
        site_boxes[:, 1] = -y
        site_boxes[:, 6] = -yaw
    return site_boxes


def from_published(
    weights: dict[str, Tensor], network: VoxelNet, origin: str | Path
) -> dict[str, Tensor]:
    """Published tensors by their names in `network`.

    weights: tensors by their published names; origin: the file, for errors. Raises ValueError
    unless all are present in the right shapes.
    """
    state = network.state_dict()
    # the published linear layers are 1x1 convolutions
    linear = {
        name: tensor[..., None, None]
        for name, tensor in state.items()
        if name.endswith("linear.weight")
    }
    expected = {name_in_paper(name): tensor for name, tensor in (state | linear).items()}
    check_tensors(expected, weights, origin)
    tensors = {
        name: weights[name_in_paper(name)].reshape(tensor.shape) for name, tensor in state.items()
    }
    # inputs of the first layer: position and offset of a point, each x, up, y
    first_layer = "features.layers.0.linear.weight"
    columns = [*_UP_LAST, *(3 + k for k in _UP_LAST)]
    tensors[first_layer] = tensors[first_layer][:, columns]
    return tensors


def name_in_paper(name: str) -> str:
    """Published name of a tensor, by its name in `VoxelNet`. Raises ValueError if it has none."""
    for pattern, published_name in _NAMES:
        if match := re.match(pattern, name):
            return published_name(*map(int, match.groups())) + name[match.end() :]
    raise ValueError(f"the published network has no counterpart of {name}")
