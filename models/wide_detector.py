"""`WideVoxelNetDetector`: detection in an area too large for one grid, block by block."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
import torch

from models.config import MAX_COLUMNS, VoxelNetConfig
from models.detector import VoxelNetDetector
from models.network import candidates as decoding
from models.network.grid import Voxels, collate, voxelise
from models.network.voxelnet import VoxelNet
from toolkit.arrays import Float, Float64, Int64
from toolkit.objects import Detections

BLOCK_CELLS = 512  # side of a block of a wide area, a multiple of the coarsest stride
MARGIN_CELLS = 128  # around a block, a multiple of the coarsest stride
MAX_CENTRE_DISTANCE_M = 10.0  # from a point of a body to the centre of its box, along x or y
_Area = tuple[float, float, float, float]  # xmin ymin xmax ymax, m


def is_wide(area: _Area, config: VoxelNetConfig) -> bool:
    """True if an area has more columns of voxels than one grid may have."""
    xmin, ymin, xmax, ymax = area
    dx, dy = config.voxel_size[:2]
    # a grid is rounded up to a multiple of 8 voxels along each side
    return ((xmax - xmin) / dx + 8) * ((ymax - ymin) / dy + 8) > MAX_COLUMNS


class WideVoxelNetDetector(VoxelNetDetector):
    """Detector of one network in an area too large for one grid, block by block.

    A box depends on the points within some metres, so a grid of one block, with a margin on every
    side, detects there what a grid of the whole area detects. Blocks are aligned with the whole
    grid's cells, and only blocks with points in or near them are computed. network: for any area,
    with coordinates from its voxels. Other arguments as in `VoxelNetDetector`.
    """

    def __init__(
        self,
        network: VoxelNet,
        area: _Area,
        *,
        device: str | torch.device = "cpu",
        score_threshold: float | None = None,
        nms_threshold: float = 0.1,
    ) -> None:
        """Make the network's grid one block, and detect in an area block by block.

        area: xmin, ymin, xmax, ymax (m); score_threshold: lowest score of a detection, None for the
        network's thresholds; nms_threshold: footprint IoU above which the weaker of two boxes is
        dropped."""
        cells = BLOCK_CELLS + 2 * MARGIN_CELLS
        sides = cells * network.config.voxel_size[0], cells * network.config.voxel_size[1]
        block = VoxelNet(replace(network.config, area=(0.0, 0.0, *sides)))
        block.load_state_dict(network.state_dict())
        super().__init__(
            block, device=device, score_threshold=score_threshold, nms_threshold=nms_threshold
        )
        self._tiled = None  # unions are detected one after another
        self._wide = area

    @property
    def area(self) -> _Area:
        """Area of detection: xmin ymin xmax ymax, m, world frame."""
        return self._wide

    @property
    def digest(self) -> str:
        """SHA-256 of weights, configuration and thresholds, with the area."""
        return f"{super().digest} in {' '.join(f'{side:g}' for side in self._wide)}"

    def batch(self, clouds: Sequence[Float[np.ndarray, "_ 3"]]) -> list[Detections]:
        """Detections of each of several clouds, computed block by block."""
        return [self._detect_blocks(np.asarray(cloud)) for cloud in clouds]

    def _detect_blocks(self, cloud: Float[np.ndarray, "n 3"]) -> Detections:
        """Detections of one cloud (x y z, m) in the whole area, found block by block.

        Each block is detected together with a margin around it, in a grid whose origin is the
        margin's corner. Only candidates of anchors in the block itself are kept, so that each
        anchor of the area counts once. Duplicates and rivals are then found among the candidates of
        all blocks, as in one grid."""
        voxel = np.array(self.config.voxel_size[:2])
        low = np.array(self._wide[:2])  # corners of the area: x, y (m)
        high = np.array(self._wide[2:])
        block = BLOCK_CELLS * voxel  # sides along x and y, m
        margin = MARGIN_CELLS * voxel
        z = cloud[:, 2]
        min_z, max_z = self.config.height
        xy = cloud[:, :2].astype(np.float64)
        is_inside = ((xy > low) & (xy < high)).all(axis=1)
        is_inside &= (z > min_z) & (z < max_z)
        z = z[is_inside]
        xy = xy[is_inside]
        parts = []
        for number in _list_blocks(xy - low, block, high - low):
            start = low + number * block - margin  # origin of the block's grid
            is_near = ((xy > start) & (xy < start + block + 2 * margin)).all(axis=1)
            points = np.column_stack([xy[is_near] - start, z[is_near]]).astype(np.float32)
            voxels = voxelise(torch.from_numpy(points).to(self.device), self.config)
            if len(voxels.cells):
                parts.append(self._find_block_candidates(voxels, start))
        if not parts:
            return Detections.empty()
        boxes = torch.cat([part.boxes for part in parts])
        scores = torch.cat([part.scores for part in parts])
        return self.finish_detections(boxes, scores, cloud)

    def _find_block_candidates(
        self, voxels: Voxels, start: Float64[np.ndarray, "2"]
    ) -> decoding.BestCandidates:
        """Best candidates of the anchors in one block, world frame.

        voxels: points of the block and its margin; start: x, y of the margin's corner (m)."""
        classified = self.network.classify(collate([voxels]))
        candidates = decoding.all_candidates(
            classified, self.anchors, self.config, self._least_scores
        )
        # for each candidate; the map's rows go along x, its columns along y
        cell = candidates.place // len(self.config.anchor_labels)
        columns = self.config.map_shape[1]
        is_in_block = torch.ones_like(cell, dtype=torch.bool)
        for index in (cell // columns, cell % columns):
            # the map has half as many cells along x and y as the grid, in which both are counted
            is_in_block &= index >= MARGIN_CELLS // 2
            is_in_block &= index < (MARGIN_CELLS + BLOCK_CELLS) // 2
        best = candidates.best(torch.nonzero(is_in_block)[:, 0])
        # by x and y of the origin; z, length, width, height and yaw stay
        shift = torch.from_numpy(np.append(start, np.zeros(5))).to(best.boxes.device)
        return best._replace(boxes=best.boxes.double() + shift)


def _list_blocks(
    xy: Float64[np.ndarray, "n 2"], block: Float64[np.ndarray, "2"], area: Float64[np.ndarray, "2"]
) -> Int64[np.ndarray, "b 2"]:
    """Numbers along x and y of the blocks in which the centre of a body may be, ascending.

    xy: points from the area's first corner (m); block, area: sides along x and y (m)."""
    last = np.ceil(area / block).astype(np.int64) - 1
    ids = []
    for x_sign, y_sign in product((-1, 1), repeat=2):
        moved_xy = xy + MAX_CENTRE_DISTANCE_M * np.array([x_sign, y_sign])
        numbers = np.clip(np.floor(moved_xy / block).astype(np.int64), 0, last)
        ids.append(np.unique(numbers[:, 0] * (last[1] + 1) + numbers[:, 1]))
    return np.stack(np.divmod(np.unique(np.concatenate(ids)), last[1] + 1), axis=1)
