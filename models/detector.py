"""`VoxelNetDetector`: a trained network as the toolkit's `Detector`, points of a frame in, `Detections` out."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import SupportsFloat

import numpy as np
import torch
from torch import Tensor

from models.network.anchors import anchors
from models.network.candidates import Candidates, all_candidates, candidates, suppressed
from models.network.faces import measured
from models.network.rivals import LEAST_RIVAL, contested
from models.network.sparse import SparseVoxelNet
from models.network.tiles import Entries, TiledVoxelNet, TilePredictions, tileable
from models.network.voxelnet import VoxelNet
from models.network.voxels import collate, voxelise
from models.weight_files import digest_of, digest_with, load_weights
from toolkit.arrays import Bool, Float
from toolkit.objects import LABELS, Detections, label_index
from toolkit.points import union_of
from toolkit.runtime.parallel import keep_freed_memory

SHIPPED = Path(__file__).parent / "weights"


class VoxelNetDetector:
    """Points (n, 3) in the world frame, m -> `Detections` in the world frame.

    Points outside the network's area are ignored, and so are boxes whose centre is outside it. score_threshold:
    detections at or below it are dropped, None for the configuration's own, which may differ by label. nms_threshold:
    of two boxes of one class whose footprints have a larger IoU, the better scored one stays (0.1 in the paper).

    >>> from models.config import VoxelNetConfig
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
        self._tiled = TiledVoxelNet(self.network) if tileable(self.network) else None
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

    def unions(self, clouds: Sequence[Float[np.ndarray, "_ 3"]], unions: Bool[np.ndarray, "U C"]) -> list[Detections]:
        """Detect in many unions of the same clouds, such as those of all sets of a site's sensors: what the points of
        each give together, to the rounding of float32. It takes much less time than one after the other where most
        clouds reach a part of the area only (`models.network.tiles`)."""
        found = dict(self._at_once(clouds, unions)) if clouds else {}
        return [found[row] if row in found else self(union_of(clouds, union)) for row, union in enumerate(unions)]

    def _at_once(
        self, clouds: Sequence[Float[np.ndarray, "_ 3"]], unions: Bool[np.ndarray, "U C"]
    ) -> Iterator[tuple[int, Detections]]:
        """Rows of unions and what is detected in them: of those that gain by going together."""
        if self._tiled is None:
            return
        plan = self._tiled.plan([torch.as_tensor(cloud).float().to(self.device) for cloud in clouds], unions)
        if not len(unions) or not self._tiled.gains(plan):
            return
        reaching = (unions & (plan.placed.counts() > 0).cpu().numpy()).any(axis=1)
        for some, entries, predictions in self._tiled(plan):
            rows = np.arange(len(unions))[some].tolist()
            for row, boxes in zip(rows, self._by_union(entries, predictions), strict=True):
                if reaching[row]:
                    sure = self._sure(suppressed(*boxes, self.config, self.nms_threshold))
                    yield row, self._measured(sure, union_of(clouds, unions[row]))

    def _by_union(self, entries: Entries, predictions: Iterable[TilePredictions]) -> Iterator[tuple[Tensor, Tensor]]:
        """Boxes and scores of each union, in the order of the map."""
        parts = []
        for first, corner, maps in predictions:
            part = all_candidates(maps, self.anchors, self.config, self._looked_at, corner)
            parts.append(part._replace(item=part.item + first))
        found = Candidates(*(torch.cat(column) for column in zip(*parts, strict=True)))
        count = torch.bincount(found.item, minlength=len(entries.tile)).cpu().numpy()
        begin = np.cumsum(count) - count
        for of in entries.of.T:
            row = np.repeat(begin[of] - np.cumsum(count[of]) + count[of], count[of]) + np.arange(count[of].sum())
            rows = torch.from_numpy(row).to(found.item.device)
            yield found.of(rows[torch.argsort(found.place[rows])]).best()

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
