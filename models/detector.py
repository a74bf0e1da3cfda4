"""`VoxelNetDetector`: a trained network as the toolkit's `Detector`, points of a frame in, `Detections` out."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import SupportsFloat

import numpy as np
import torch
from torch import Tensor

from models.config import VoxelNetConfig
from models.network.anchors import anchors, decode, per_anchor
from models.network.faces import measured
from models.network.rivals import LEAST_RIVAL, contested
from models.network.sparse import SparseVoxelNet
from models.network.voxelnet import Prediction, VoxelNet
from models.network.voxels import collate, voxelise
from models.weight_files import digest_of, digest_with, load_weights
from toolkit.arrays import Bool, Float, Float32, Int64
from toolkit.boxes import iou_bev, nms
from toolkit.objects import LABELS, Detections, label_index
from toolkit.runtime.memory import keep_freed_memory

SHIPPED = Path(__file__).parent / "weights"
MOST_CANDIDATES = 2000  # per cloud, before non-maximum suppression
_SURE_LOGIT, _ROUNDING = 8.0, 0.01  # logits above the first are rounded by more than the second


class VoxelNetDetector:
    """Points (n, 3) in the world frame, m -> `Detections` in the world frame.

    Points outside the network's area are ignored, and so are boxes whose centre is outside it. score_threshold:
    detections at or below it are dropped, None for the configuration's own, which may differ by label. nms_threshold:
    of two boxes of one class whose footprints have a larger IoU, the better scored one stays (0.1 in the paper).

    >>> detector = VoxelNetDetector(VoxelNet(VoxelNetConfig.light((-8, -8, 8, 8))))
    >>> len(detector(np.zeros((0, 3), np.float32)))
    0
    """

    def __init__(
        self,
        network: VoxelNet,
        *,
        device: str | torch.device = "cpu",
        score_threshold: float | None = None,
        nms_threshold: float = 0.1,
    ) -> None:
        self.config = network.config
        self.device = torch.device(device)
        if self.device.type == "cpu":
            keep_freed_memory()  # its maps come and go with every cloud
        own = self.config.thresholds or (self.config.score_threshold,) * len(self.config.labels)
        self.thresholds = own if score_threshold is None else (score_threshold,) * len(own)
        rivals = bool(self.config.rivalry)
        self._looked_at = tuple(min(least, LEAST_RIVAL) if rivals else least for least in self.thresholds)
        self.nms_threshold = nms_threshold
        self._weights = digest_of(network.state_dict())
        self.network = SparseVoxelNet(network).to(self.device)
        self.anchors = anchors(self.config).to(self.device)
        self.faces = None if network.faces is None else copy.deepcopy(network.faces).cpu().eval()

    @property
    def area(self) -> tuple[float, float, float, float]:
        """xmin ymin xmax ymax, m, world frame: where it detects."""
        return self.config.area

    @property
    def labels(self) -> tuple[str, ...]:
        """The classes it knows, names of `toolkit.objects.LABELS`."""
        return self.config.labels

    @property
    def digest(self) -> str:
        """SHA-256 of what its detections depend on: weights, configuration and thresholds."""
        least = self.thresholds if len(set(self.thresholds)) > 1 else self.thresholds[0]
        return digest_with(self._weights, self.config.to_dict(), least, self.nms_threshold)

    def __call__(self, points: Float[np.ndarray, "n 3"], /) -> Detections:
        """Detect in one cloud."""
        return self.batch([points])[0]

    def batch(self, clouds: Sequence[Float[np.ndarray, "_ 3"]]) -> list[Detections]:
        """Detect in several clouds at once; the same as one after the other."""
        voxels = [voxelise(torch.as_tensor(cloud).to(self.device), self.config) for cloud in clouds]
        if not any(len(each.cells) for each in voxels):
            return [Detections.empty() for _ in clouds]
        prediction = self.network(collate(voxels))
        found = candidates(prediction, self.anchors, self.config, self._looked_at)
        return [
            self._measured(self._sure(suppressed(*each, self.config, self.nms_threshold)), cloud)
            if len(cells.cells)
            else Detections.empty()
            for each, cells, cloud in zip(found, voxels, clouds, strict=True)
        ]

    def _sure(self, found: Detections) -> Detections:
        """The detections that are above the thresholds with the scores that their rivals leave them."""
        if not self.config.rivalry:
            return found
        least = np.zeros(len(LABELS))
        least[[label_index(name) for name in self.labels]] = self.thresholds
        found = contested(found, self.config)
        return found[found.scores > least[found.labels]]

    def _measured(self, found: Detections, cloud: Float[np.ndarray, "n 3"]) -> Detections:
        """The detections with the faces of their boxes where the points end, if the network measures any."""
        if self.faces is None:
            return found
        return measured(self.faces, found, np.asarray(cloud), self.config.faces)


def candidates(
    prediction: Prediction,
    anchors: Float32[Tensor, "H W A 7"],
    config: VoxelNetConfig,
    thresholds: Sequence[float],
) -> list[tuple[Float32[Tensor, "n 7"], Float32[Tensor, "n L"]]]:
    """Per cloud, the boxes of the best anchors above the threshold of a label, and their score for each label, 0 where
    it is not above that."""
    count = len(config.anchor_labels)
    logits, residuals = (per_anchor(each, count) for each in (prediction.class_logits, prediction.residuals))
    quality, direction = (
        None if each is None else per_anchor(each, count)[..., 0]
        for each in (prediction.quality_logits, prediction.direction_logits)
    )
    label = torch.tensor(config.anchor_labels, device=logits.device)
    own = torch.eye(len(config.labels), device=logits.device)
    least = torch.tensor(thresholds, dtype=logits.dtype, device=logits.device)
    found = []
    for item, some in enumerate(hopeful(logits, least, config)):
        cell = torch.nonzero(some, as_tuple=True)
        at = label[cell[2]]
        scores = _scores(logits[item][cell], None if quality is None else quality[item][cell][:, None], at, config)
        scores = torch.where(scores > (least[at][:, None] if config.kinds else least), scores, 0.0)
        best = scores.amax(-1)
        chosen = torch.nonzero(best > 0)[:, 0]
        if len(chosen) > MOST_CANDIDATES:
            chosen = chosen[torch.topk(best[chosen], MOST_CANDIDATES).indices]
        scores, at, cell = scores[chosen], at[chosen], tuple(axis[chosen] for axis in cell)
        turned = None if direction is None else direction[item][cell] > 0
        by_label = scores * own[at] if config.kinds else scores
        found.append((decode(residuals[item][cell], anchors[cell], turned), by_label))
    return found


def label_scores(prediction: Prediction, config: VoxelNetConfig) -> Float[Tensor, "B H W A L"]:
    """How sure the network is of each label at each anchor, 0 to 1; where anchors are of one class, of that alone."""
    count = len(config.anchor_labels)
    logits = per_anchor(prediction.class_logits, count)
    quality = None if prediction.quality_logits is None else per_anchor(prediction.quality_logits, count)
    return _scores(logits, quality, torch.tensor(config.anchor_labels, device=logits.device), config)


def _scores(
    logits: Float[Tensor, "*n K"], quality: Float[Tensor, "*n 1"] | None, label: Int64[Tensor, "*m"],
    config: VoxelNetConfig,
) -> Float[Tensor, "*n L"]:  # fmt: skip
    """`label_scores` of anchors of these labels (of all anchors, or of those of a cell)."""
    if config.head == "published":
        return torch.softmax(logits, -1)[..., 1:]
    scores = torch.sigmoid(logits)
    if quality is not None and config.quality_power:
        scores = scores * torch.sigmoid(quality) ** config.quality_power
    return calibrated(scores, label, config)


def calibrated(
    scores: Float[Tensor, "*n L"], label: Int64[Tensor, "*m"], config: VoxelNetConfig
) -> Float[Tensor, "*n L"]:
    """Scores that say which share of the detections of that score are true, by the configuration's calibration."""
    if not config.calibration:
        return scores
    slope, intercept = _calibration(label, config, scores)
    return torch.sigmoid(torch.logit(scores, 1e-6) * slope + intercept)


def _calibration(label: Tensor, config: VoxelNetConfig, like: Tensor) -> tuple[Tensor, Tensor]:
    """Slope and intercept for anchors of these labels."""
    by_label = torch.tensor(config.calibration, dtype=like.dtype, device=like.device)
    slope, intercept = by_label[label].T[..., None] if config.kinds else by_label.T
    return slope, intercept


def hopeful(
    logits: Float[Tensor, "B H W A K"], least: Float[Tensor, " L"], config: VoxelNetConfig
) -> Bool[Tensor, "B H W A"]:
    """Anchors, hardly any, that can have a score above the least of a label: a glance at their class alone.

    A predicted IoU only lowers a score. Whoever is left out would be, with all that is known of it.
    """
    if config.head == "published":
        return (torch.softmax(logits, -1)[..., 1:] > least).any(-1)
    label = torch.tensor(config.anchor_labels, device=logits.device)
    bound = torch.logit(least[label][:, None] if config.kinds else least)
    if config.calibration:
        slope, intercept = _calibration(label, config, logits)
        bound = (bound - intercept) / slope
    bound = torch.where(bound > math.log(1e-6), bound.clamp(max=_SURE_LOGIT), -torch.inf)
    return (logits > bound - _ROUNDING).any(-1)


def suppressed(
    boxes: Float[Tensor, "n 7"], scores: Float[Tensor, "n L"], config: VoxelNetConfig, nms_threshold: float
) -> Detections:
    """Candidates without those whose centre is outside the area, and without duplicates."""
    xmin, ymin, xmax, ymax = config.area
    x, y = boxes[:, 0], boxes[:, 1]
    inside = (x >= xmin) & (x <= xmax) & (y >= ymin) & (y <= ymax) & torch.isfinite(boxes).all(1)
    best, label = scores[inside].max(1)
    labels = np.array([label_index(name) for name in config.labels])[label.cpu().numpy()]
    found = Detections(boxes[inside].double().cpu().numpy(), best.double().cpu().numpy(), labels)
    kept = nms(found.boxes, found.scores, nms_threshold, labels=found.labels)
    return averaged(found, kept, config.averaging) if config.averaging else found[kept]


def averaged(candidates: Detections, kept: Int64[np.ndarray, " k"], iou_threshold: float) -> Detections:
    """The candidates kept, each box the mean of those of its class whose footprints overlap it by more than the
    threshold, weighted by their squared scores: neighbouring anchors err independently ("box voting", Gidaris and
    Komodakis 2015)."""
    boxes, best = candidates.boxes, candidates.boxes[kept]
    together = (iou_bev(best, boxes) > iou_threshold) & (candidates.labels[kept][:, None] == candidates.labels)
    weights = np.where(together, candidates.scores**2, 0.0)
    weights[np.arange(len(kept)), kept] = candidates.scores[kept] ** 2
    weights /= weights.sum(axis=1, keepdims=True)
    turn = boxes[:, 6] - best[:, 6:]
    turn = (turn + np.pi / 2) % np.pi - np.pi / 2  # a candidate that faces the other way lies along the same line
    mean = weights @ boxes
    mean[:, 6] = best[:, 6] + (weights * turn).sum(axis=1)
    return Detections(mean, candidates.scores[kept], candidates.labels[kept])


def load_detector(
    name: str | Path,
    *,
    site: str | None = None,
    area: Iterable[SupportsFloat] | None = None,
    device: str | torch.device = "cpu",
    score_threshold: float | None = None,
    nms_threshold: float = 0.1,
) -> VoxelNetDetector:
    """The detector of a weights file: a name of `models/weights` ("tjunction", "roundabout", "general", ...) or a path.

    site: the site it must have been trained for. area: xmin ymin xmax ymax (m, world frame) where it shall detect;
    weights of one site have their own, general ones go anywhere.

    Raises FileNotFoundError where there are no such weights, ValueError where they are damaged or for elsewhere.
    """
    network, header = load_weights(weights_file(name))
    trained_for = header.site or "general"
    if site is not None and trained_for not in (site, "general"):
        raise ValueError(f"{name} holds weights for {trained_for!r}, not for {site!r}: load {site!r} or 'general'")
    if area is not None:
        xmin, ymin, xmax, ymax = (float(side) for side in area)
        network = relocated(network, (xmin, ymin, xmax, ymax), trained_for)
    return VoxelNetDetector(network, device=device, score_threshold=score_threshold, nms_threshold=nms_threshold)


def load_site_detector(site: str, area: Iterable[SupportsFloat]) -> VoxelNetDetector:
    """The shipped network that was trained for a site (its name) or, where there is none, the general one, for an area
    (xmin ymin xmax ymax, m, world frame)."""
    own = (SHIPPED / f"{site}.safetensors").exists()
    return load_detector(site if own else "general", area=area)


def relocated(network: VoxelNet, area: tuple[float, float, float, float], trained_for: str) -> VoxelNet:
    """The same weights on another area. Raises ValueError where they know one area only."""
    config = network.config
    if area == config.area:
        return network
    if trained_for != "general" or config.point_features != "local":
        raise ValueError(f"these weights are for the area {config.area} of {trained_for!r}, got {area}: load 'general'")
    elsewhere = VoxelNet(replace(config, area=area))
    elsewhere.load_state_dict(network.state_dict())
    return elsewhere


def weights_file(name: str | Path) -> Path:
    """Where weights of this name are shipped, or the path itself. Raises FileNotFoundError for an unknown name."""
    path = Path(name)
    if path.suffix == ".safetensors":
        return path
    shipped = SHIPPED / f"{name}.safetensors"
    if not shipped.exists():
        names = ", ".join(sorted(each.stem for each in SHIPPED.glob("*.safetensors"))) or "none yet"
        raise FileNotFoundError(
            f"no weights named {str(name)!r}; shipped: {names}; or give the path of a .safetensors file"
        )
    return shipped
