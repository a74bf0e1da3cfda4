"""`VoxelNetDetector`: a trained network as the toolkit's `Detector`."""

import copy
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from models.config import VoxelNetConfig
from models.network import candidates as decoding
from models.network.faces import measure_faces
from models.network.grid import anchors, collate, voxelise
from models.network.number_formats import convert_to_bfloat16, find_bfloat16_library
from models.network.sparse import SparseVoxelNet
from models.network.tiles import TiledVoxelNet, UnionPlan, tileable
from models.network.voxelnet import VoxelNet
from models.weight_files import digest_detector, digest_tensors
from toolkit.arrays import Bool, Float, Points
from toolkit.boxes import nms
from toolkit.objects import LABELS, PEDESTRIAN, Detections, label_index
from toolkit.points import join_clouds
from toolkit.runtime.allocation import keep_freed_memory
from toolkit.runtime.sent_once import SentOnce

# steps with multiples that fill a square evenly (Roberts 2018)
SHIFT_STEPS = np.array([0.7548776662466927, 0.5698402909980532])
MAX_PHASES = 16
MIN_KNOWN_SCORE = 0.05  # if detections are scored again because the empty site is known
MIN_UNKNOWN_PERSON_SCORE = 0.4  # for a pedestrian at an unknown site
SAME_BOX_IOU = 0.3  # footprint overlap above which boxes of several grids are averaged
_Clouds = Sequence[Float[np.ndarray, "_ 3"]]


class VoxelNetDetector(SentOnce):
    """Detector of one network: points (n, 3) in, `Detections` out, in the world frame, m.

    Points outside the network's area are ignored, and so are boxes with their centre outside.
    score_threshold: detections at or below it are dropped; None takes the configuration's, which
    may differ by label. nms_threshold: footprint IoU above which only the better scored of
    two boxes of one class stays (0.1 in the paper).
    """

    def __init__(
        self,
        network: VoxelNet,
        *,
        device: str | torch.device = "cpu",
        score_threshold: float | None = None,
        nms_threshold: float = 0.1,
    ) -> None:
        """Fold a network for inference.

        device: of PyTorch; score_threshold: least score of a detection, None for the network's;
        nms_threshold: IoU above which the lower of two scores goes."""
        self._adopt(network.config, device, score_threshold, nms_threshold)
        self._weights = digest_tensors(network.state_dict())
        self.network = SparseVoxelNet(network).to(self.device)
        self._tiled = TiledVoxelNet(self.network) if tileable(self.network) else None
        self.faces = None if network.faces is None else copy.deepcopy(network.faces).cpu().eval()

    def _adopt(
        self,
        config: VoxelNetConfig,
        device: str | torch.device,
        score_threshold: float | None,
        nms_threshold: float,
    ) -> None:
        """Take over everything that does not need weights.

        score_threshold: least score of a detection, None for the one that `config` states;
        nms_threshold: IoU above which the lower of two scores goes."""
        self.config = config
        self.device = torch.device(device)
        if self.device.type == "cpu":
            keep_freed_memory()  # its maps come and go with every cloud
        self.name = type(self).__name__  # or the name it was loaded by
        thresholds = config.thresholds or (config.score_threshold,) * len(config.labels)
        self.thresholds = (
            thresholds if score_threshold is None else (score_threshold,) * len(thresholds)
        )
        self.known_thresholds = (
            self.thresholds
            if score_threshold is not None
            else config.known_thresholds or thresholds
        )
        self.rival_shares = None if score_threshold is not None else decoding.rival_shares(config)
        self.nms_threshold = nms_threshold
        self.phases = 1
        self.numbers: Literal["float32", "bfloat16"] = "float32"
        self.anchors = anchors(config).to(self.device)

    @property
    def area(self) -> tuple[float, float, float, float]:
        """Area of detection: xmin ymin xmax ymax, m, world frame."""
        return self.config.area

    @property
    def labels(self) -> tuple[str, ...]:
        """Known classes, names of `toolkit.objects.LABELS`."""
        return self.config.labels

    @property
    def _least_scores(self) -> tuple[float, ...]:
        """Lowest score of a candidate for each label; low enough that rivals are known."""
        max_threshold = decoding.MIN_RIVAL_SCORE if self.config.rivalry else 1.0
        return tuple(min(threshold, max_threshold) for threshold in self.thresholds)

    @property
    def digest(self) -> str:
        """SHA-256 of weights, configuration and thresholds.

        A format of numbers other than float32 counts among the weights, and several shifts of the
        grid are added behind as words."""
        # equal thresholds count as one number, as in detectors that had only one
        threshold = self.thresholds if len(set(self.thresholds)) > 1 else self.thresholds[0]
        weights = self._weights
        if self.numbers != "float32":
            weights = f"{weights} in {self.numbers}"
        digest = digest_detector(weights, self.config.to_dict(), threshold, self.nms_threshold)
        return digest if self.phases == 1 else f"{digest} on {self.phases} grids"

    def shift_grids(self, phases: int) -> "VoxelNetDetector":
        """Same detector on `phases` grids, shifted by parts of a cell, so that the position of one
        matters less.

        Boxes of one class that overlap are averaged, and have the greatest of their scores. Raises
        ValueError for fewer than one grid, or more than `MAX_PHASES`.
        """
        if not 1 <= phases <= MAX_PHASES:
            raise ValueError(
                f"phases must be 1 to {MAX_PHASES} grids, got {phases}: 4 is usual for real clouds"
            )
        shifted = copy.copy(self)
        shifted.phases = phases
        shifted.name = f"{self.name}+phases{phases}"
        return shifted

    def quick(self) -> "VoxelNetDetector":
        """Same detector in bfloat16 if the processor is much faster with it, otherwise itself.

        If OpenVINO is the faster library, unions that share work (`unions`) stay in float32."""
        library = find_bfloat16_library(self.device)
        network = getattr(self, "network", None)
        if library is None or self.numbers != "float32" or not isinstance(network, SparseVoxelNet):
            return self
        quick = copy.copy(self)
        quick.network = convert_to_bfloat16(network, library)
        quick.numbers = "bfloat16"
        quick.name = f"{self.name}+bfloat16"
        # OpenVINO has the whole map only, so tiles are still computed by torch, in float32
        if self._tiled is not None and library == "torch":
            quick._tiled = TiledVoxelNet(quick.network)
        return quick

    def __call__(self, points: Points, /) -> Detections:
        """Detections of one cloud (x y z, m), averaged over the shifts of the grid."""
        if self.phases == 1 or not len(points):
            return self.batch([points])[0]
        cell_sides = np.array(self.config.stride)  # in the map, along x and y (m)
        # detections for each shift of the grid
        parts = []
        for phase in range(self.phases):
            # shift (m) by parts of a cell of the map along x and y, spread evenly over the cell for
            # any number of phases; heights stay
            shift = np.append(phase * SHIFT_STEPS % 1 * cell_sides, 0.0)
            (detections,) = self.batch([(points + shift).astype(np.float32)])
            # for x, y, z; sizes and yaw stay
            box_shift = np.append(shift, np.zeros(4))
            parts.append(replace(detections, boxes=detections.boxes - box_shift))
        merged = Detections.merge(parts)
        kept_rows = nms(merged.boxes, merged.scores, self.nms_threshold, labels=merged.labels)
        return decoding.average_boxes(merged, kept_rows, SAME_BOX_IOU)

    def batch(self, clouds: _Clouds) -> list[Detections]:
        """Detections of each of several clouds, computed together."""
        voxels = [voxelise(torch.as_tensor(cloud).to(self.device), self.config) for cloud in clouds]
        # the network needs at least one occupied voxel
        if not any(len(cloud_voxels.cells) for cloud_voxels in voxels):
            return [Detections.empty() for _ in clouds]
        classified = self.network.classify(collate(voxels))
        candidates = decoding.candidates(classified, self.anchors, self.config, self._least_scores)
        detections = []
        for cloud, cloud_voxels, best in zip(clouds, voxels, candidates, strict=True):
            if len(cloud_voxels.cells):
                detections.append(self.finish_detections(best.boxes, best.scores, cloud))
            else:
                detections.append(Detections.empty())
        return detections

    def unions(
        self, clouds: _Clouds, unions: Bool[np.ndarray, "unions clouds"]
    ) -> list[Detections]:
        """Detections in many unions of the same clouds, such as all sets of a site's sensors.

        unions: True for the clouds of each union. The results equal the results for each union's
        points, to the rounding of float32. It takes much less time if most clouds reach only a part
        of the area (`models.network.tiles`).
        """
        by_union: dict[int, Detections] = {}
        if clouds and len(unions) and self._tiled is not None and self.phases == 1:
            plan = self._tiled.plan_gain(
                [torch.as_tensor(cloud).float().to(self.device) for cloud in clouds], unions
            )
            if plan is not None:
                by_union = dict(self._at_once(self._tiled, plan, clouds))
        return [
            by_union[row] if row in by_union else self(join_clouds(clouds, union))
            for row, union in enumerate(unions)
        ]

    def _at_once(
        self, tiled: TiledVoxelNet, plan: UnionPlan, clouds: _Clouds
    ) -> Iterator[tuple[int, Detections]]:
        """Yield the row and detections of each union of a plan that has points.

        A union is a set of clouds. What two unions share is computed once: `tiled` gives the maps
        of entries, which are the distinct tiles of all unions.

        plan: the unions; clouds: points of all clouds."""
        unions = plan.unions
        has_points = (unions & (plan.placed.counts() > 0).cpu().numpy()).any(axis=1)
        for union_rows, entries, predictions in tiled(plan):
            parts = []
            for first, corner, maps in predictions:
                tile_candidates = decoding.all_candidates(
                    maps, self.anchors, self.config, self._least_scores, corner
                )
                # number of the entry in place of its item in the batch
                parts.append(tile_candidates._replace(item=tile_candidates.item + first))
            candidates = decoding.BoxCandidates(
                *(torch.cat(column) for column in zip(*parts, strict=True))
            )
            counts = torch.bincount(candidates.item, minlength=len(entries.tile)).cpu().numpy()
            begin = np.cumsum(counts) - counts  # first row of each entry
            row_numbers = np.arange(len(unions))[union_rows].tolist()
            for row, tile_entries in zip(row_numbers, entries.entry.T, strict=True):
                if has_points[row]:
                    # rows of all candidates of the union's tiles
                    tile_counts = counts[tile_entries]
                    offset = begin[tile_entries] - np.cumsum(tile_counts) + tile_counts
                    offsets = np.repeat(offset, tile_counts)
                    rows = torch.from_numpy(offsets + np.arange(len(offsets)))
                    rows = rows.to(candidates.item.device)
                    # in map order, as for a whole map
                    best = candidates.best(rows[torch.argsort(candidates.place[rows])])
                    cloud = join_clouds(clouds, unions[row])
                    yield row, self.finish_detections(best.boxes, best.scores, cloud)

    def at_known_site(self) -> "VoxelNetDetector":
        """Variant for a site whose empty scene is known, which reports more uncertain detections.

        `score_known` of the original scores these again. A detector without a calibration for
        known sites comes back unchanged."""
        if not self.config.known:
            return self
        sensitive = copy.copy(self)
        sensitive.thresholds = tuple(
            min(threshold, MIN_KNOWN_SCORE) for threshold in self.thresholds
        )
        # None: no box is dropped because of a rival of another class; `score_known` does that by
        # the new scores
        sensitive.rival_shares = None
        return sensitive

    def at_unknown_site(self) -> "VoxelNetDetector":
        """Same detector, which reports pedestrians from `MIN_UNKNOWN_PERSON_SCORE` on.

        Trunks, posts and bins look like weak pedestrians, and nothing is known about the site."""
        strict = copy.copy(self)
        floors = [
            MIN_UNKNOWN_PERSON_SCORE if label == LABELS[PEDESTRIAN] else 0.0
            for label in self.config.labels
        ]
        strict.thresholds = tuple(map(max, self.thresholds, floors))
        return strict

    def score_known(self, detections: Detections) -> Detections:
        """Detections scored again, for use without the detections that the empty site has too.

        Without a calibration for that they come back unchanged."""
        if not self.config.known:
            return detections
        rescored = decoding.apply_rivals(
            detections, replace(self.config, rivalry=self.config.known)
        )
        return self._take_above(rescored, self.known_thresholds)

    def _take_above(self, detections: Detections, thresholds: tuple[float, ...]) -> Detections:
        """Detections above the threshold of their label that no rival of another class outdoes.

        thresholds: in the order of `labels`.
        """
        # rows of the arrays below are all of `LABELS`, since detections have their numbers
        rows = [label_index(name) for name in self.labels]
        min_scores = np.zeros(len(LABELS))
        shares = np.zeros((len(LABELS), len(rows)))
        min_scores[rows] = thresholds
        detections = detections[detections.scores > min_scores[detections.labels]]
        if self.rival_shares is None:
            return detections
        shares[rows] = self.rival_shares
        rivals = shares[detections.labels] * decoding.strongest_rivals(detections, self.config)
        return detections[detections.scores >= rivals.max(axis=1)]

    def finish_detections(self, boxes: Tensor, scores: Tensor, cloud: Points) -> Detections:
        """Detections of one cloud's candidates: without duplicates and rivals, faces measured.

        boxes, scores: one for each candidate; cloud: its points (m)."""
        detections = decoding.suppress_boxes(
            boxes, scores, self.config, self.nms_threshold, area=self.area
        )
        if self.config.rivalry or self.rival_shares is not None:
            detections = self._take_above(
                decoding.apply_rivals(detections, self.config), self.thresholds
            )
        if self.faces is None:
            return detections
        return measure_faces(self.faces, detections, np.asarray(cloud), self.config.faces)
