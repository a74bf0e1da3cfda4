"""Background of an empty site, and detectors that know it.

A point in a voxel of the empty site, or in a neighbouring voxel, belongs to the site. Any other
point belongs to a road user, whichever sensor sees it. To a detector, some parts of a site look
like road users: a bush, a container, a gap in a hedge. They appear in every frame. Most points of a
road user are outside the empty site's voxels, so a detection with few such points is dropped. This
costs recall only for objects that were present while the site was learnt and never left."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Bool, Float, Float32, Float64, Mask, Points
from toolkit.boxes import rows_in_boxes
from toolkit.detection.provenance import detector_origin
from toolkit.frame import empty_scene
from toolkit.geometry import level_rows
from toolkit.objects import Detections, Detector, UnionDetector, quick_detector
from toolkit.points import Crop, frame_points, join_clouds
from toolkit.rendering.static_scene import build_scenery
from toolkit.runtime.sent_once import SentOnce
from toolkit.sites.site import Site

if TYPE_CHECKING:
    from toolkit.datasets.dataset import CoopDataset

VOXEL_M = 0.15  # edge
POINTS_PER_FACE = 2.0  # points on each square of a surface as large as a voxel's side
EMPTY_SWEEPS = 4  # sweeps of the empty scene, with different noise
_MAX_GROUND_RISE_M = 0.5  # above the median; higher low points are of walls and bodies
_MIN_HEIGHT_M = -1.0  # above the plane of the ground, which may dip below it
_BATCH_POINTS = 1 << 20  # drawn together
AREA_VOXELS = 1 << 26  # in an area; larger areas get larger voxels
MAX_VOXELS = 1 << 28  # in a background
MIN_NEW_SHARE = 0.2  # share of the points in a box that must not be background


@dataclass(frozen=True)
class Background:
    """Voxels of the empty site and its ground height.

    Attributes:
        origin: lowest corner (3,) of the grid (m).
        voxel: edge of a voxel (m).
        occupied: mask (nx, ny, nz) of voxels with points, and of their neighbours.
        cell: edge of a ground cell (m).
        ground: height (kx, ky) of the ground in each cell (m).
    """

    origin: Float64[np.ndarray, "3"]
    voxel: float
    occupied: Bool[np.ndarray, "nx ny nz"]
    cell: float
    ground: Float64[np.ndarray, "kx ky"]

    @staticmethod
    def learn(points: Points, voxel: float = VOXEL_M, cell: float = 1.0) -> "Background":
        """Learn from points (m) of the empty site, best from several sweeps with different noise.

        voxel: edge of a voxel (m); cell: edge of a ground cell (m). Raises ValueError without
        points, for points that are not finite, and for more than `MAX_VOXELS` voxels."""
        if not len(points):
            raise ValueError(
                "the background needs at least one point of the empty site, got none: crop less?"
            )
        size = np.ptp(points, axis=0)
        # along each axis, 5 more voxels than the points fill: empty layers, and rounding
        if not np.isfinite(points).all() or np.prod(size / voxel + 5.0) > MAX_VOXELS:
            raise ValueError(
                f"the background must be finite and small, got {size} m: crop to the area"
            )
        # two empty layers around all points: one to grow into, one that is never occupied
        origin = points.min(axis=0).astype(np.float64) - 2 * voxel
        # voxel (x, y, z) of each point; 2 is the lowest but for rounding
        voxel_index = np.maximum(((points - origin) / voxel).astype(np.int64), 2)
        is_occupied = np.zeros(voxel_index.max(axis=0) + 3, bool)
        is_occupied[tuple(voxel_index.T)] = True
        # each turn also grows what the turns before added: a cube of 27 voxels around a point
        for axis in range(3):
            is_occupied |= np.roll(is_occupied, 1, axis) | np.roll(is_occupied, -1, axis)
        ground = _estimate_ground(points, origin, cell)
        return Background(origin, voxel, occupied=is_occupied, cell=cell, ground=ground)

    def holds(self, points: Points) -> Mask:
        """Mask of points (m) in an occupied voxel; points outside the grid are not."""
        index = np.clip((points - self.origin) / self.voxel, 0, np.array(self.occupied.shape) - 1)
        # the outermost layer is never occupied
        return self.occupied[tuple(index.astype(np.int64).T)]

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the voxels and the ground."""
        return self.digest_settings(b"")

    def digest_settings(self, settings: bytes) -> str:
        """SHA-256 of settings and the background together."""
        sha = hashlib.sha256(settings)
        for value in (self.origin, self.voxel, self.occupied, self.cell, self.ground):
            sha.update(repr(np.shape(value)).encode() + np.ascontiguousarray(value).tobytes())
        return sha.hexdigest()

    def height(self, xy: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        """Height of the ground (m) at positions; outside the grid, height of the nearest cell."""
        cell_index = np.clip((xy - self.origin[:2]) / self.cell, 0, np.array(self.ground.shape) - 1)
        return self.ground[tuple(cell_index.astype(np.int64).T)]


def _estimate_ground(
    points: np.ndarray, origin: np.ndarray, cell: float
) -> Float64[np.ndarray, "kx ky"]:
    """Estimate the ground height (m) of each cell, seen from above.

    points: x, y, z (m) of points of the empty site; origin: lowest corner of the grid (m); cell:
    edge of a cell (m). A cell takes the 5 % quantile of its points' heights, then the minimum
    within two cells. Cells without points, or more than `_MAX_GROUND_RISE_M` above the median, take
    the height of their neighbours."""
    from scipy.ndimage import minimum_filter

    x_index, y_index = ((points[:, :2] - origin[:2]) / cell).astype(np.int64).T
    shape = (int(x_index.max()) + 1, int(y_index.max()) + 1)
    cell_index = x_index * shape[1] + y_index  # in the flat grid
    # sort points by cell, and by height in each cell
    height = points[:, 2]
    order = np.lexsort((height, cell_index))
    cells, starts, counts = np.unique(cell_index[order], return_index=True, return_counts=True)
    # a twentieth of the cell's points are below its low point
    low_height = height[order[starts + counts // 20]].astype(np.float64)
    is_raised = low_height > np.median(low_height) + _MAX_GROUND_RISE_M
    ground = np.full(shape, np.inf)  # infinite in cells without points
    ground.ravel()[cells] = np.where(is_raised, np.inf, low_height)
    # fill unknown cells from their neighbours, one ring of cells in each round
    while np.isinf(ground).any():
        ground = np.where(np.isinf(ground), minimum_filter(ground, 3, mode="nearest"), ground)
    # minimum over 5 x 5 cells: two to either side
    return np.asarray(minimum_filter(ground, 5, mode="nearest"))


@dataclass(frozen=True)
class KnownBackground(SentOnce):
    """Detector that leaves out its detections of the background.

    detector: finds road users, and background by mistake; background: voxels of the site, in the
    frame of the points that are passed; least: minimum share, above 0 and at most 1, of the points
    in a detection's box that are not background. Raises ValueError for any other share."""

    detector: Detector
    background: Background
    least: float = MIN_NEW_SHARE

    def __post_init__(self) -> None:
        """Raise ValueError for a share out of range."""
        if not 0 < self.least <= 1:
            raise ValueError(
                f"least must be a share above 0, at most 1, got {self.least}: such as "
                f"{MIN_NEW_SHARE}"
            )

    @property
    def name(self) -> str:
        """Name of the detector in commands."""
        return f"{detector_origin(self.detector)['detector']}+background"

    @property
    def labels(self) -> tuple[str, ...]:
        """Classes of the detector, or AttributeError."""
        return self.detector.labels  # type: ignore[attr-defined]

    @property
    def digest(self) -> str:
        """SHA-256 of detector and background, or AttributeError."""
        detector_digest = self.detector.digest  # type: ignore[attr-defined]
        settings = repr((detector_digest, self.background.digest, self.least))
        return hashlib.sha256(settings.encode()).hexdigest()

    @cached_property
    def _candidate_detector(self) -> Detector:
        """Detector that finds candidates: a variant for known sites if there is one.

        The variant reports more uncertain detections, which its `score_known` scores afterwards."""
        at_known_site = getattr(self.detector, "at_known_site", None)
        return self.detector if at_known_site is None else at_known_site()

    def quick(self) -> "KnownBackground":
        """Return the same detector in its faster form (`quick_detector`)."""
        return replace(self, detector=quick_detector(self.detector))

    def __call__(self, points: Points, /) -> Detections:
        """Detect in points (m), and drop detections of the background."""
        detections = self._candidate_detector(points)
        if not len(detections):
            return detections
        return self._drop_background(detections, points, self._find_foreground(points))

    def unions(
        self, clouds: Sequence[Float[np.ndarray, "_ 3"]], unions: Bool[np.ndarray, "unions clouds"]
    ) -> list[Detections]:
        """Detect in several unions of the same clouds, each cloud compared with the site once.

        clouds: points (m) of each sensor; unions: mask of the clouds in each union.
        Returns the detections in each union, background left out."""
        # candidates are road users, and parts of the background by mistake
        if isinstance(self._candidate_detector, UnionDetector):
            union_detections = self._candidate_detector.unions(clouds, unions)
        else:
            union_detections = [
                self._candidate_detector(join_clouds(clouds, union)) for union in unions
            ]
        foreground = [self._find_foreground(cloud) for cloud in clouds]
        kept_detections = []
        for detections, union in zip(union_detections, unions, strict=True):
            points = join_clouds(clouds, union)
            masks = [mask for mask, is_member in zip(foreground, union, strict=True) if is_member]
            is_foreground = np.concatenate([np.zeros(0, np.bool_), *masks])
            kept_detections.append(self._drop_background(detections, points, is_foreground))
        return kept_detections

    def _find_foreground(self, points: Float[np.ndarray, "p 3"]) -> Mask:
        """Return the mask of finite points (m) outside the background."""
        is_foreground = np.isfinite(points).all(axis=1)
        is_foreground[is_foreground] = ~self.background.holds(points[is_foreground])
        return is_foreground

    def _drop_background(
        self, detections: Detections, points: Float[np.ndarray, "p 3"], is_foreground: Mask
    ) -> Detections:
        """Keep detections with enough points outside the background, and score them again.

        points: all points (m), background included; is_foreground: mask of the points outside
        the background. Enough is at least one, and the share `least` of all points in the box."""
        rows_of_boxes = rows_in_boxes(points, detections.boxes)
        point_count = np.array([len(rows) for rows in rows_of_boxes], np.int64)
        foreground_count = np.array(
            [np.count_nonzero(is_foreground[rows]) for rows in rows_of_boxes], np.int64
        )
        is_enough = (foreground_count > 0) & (foreground_count >= self.least * point_count)
        kept_detections = detections[is_enough]
        # networks have other scores for detections that are known not to be background
        rescore = getattr(self.detector, "score_known", None)
        return kept_detections if rescore is None else rescore(kept_detections)


def recording_background(recording: "CoopDataset") -> Background:
    """Learn the background of a recording at its site.

    It is the scenery of the site if known, else whatever is behind all moving objects. Objects that
    park throughout become background."""
    if recording.site.solids:  # buildings and other bodies of the scenery
        return site_background(recording.site)
    return Background.learn(np.concatenate(list(empty_sweeps(recording))))


def empty_sweeps(recording: "CoopDataset") -> Iterator[Float32[np.ndarray, "_ 3"]]:
    """Yield the points of each sensor in each of four noisy sweeps of the empty site.

    Road users are left out of the scene. Points (m) are cropped to the site; z is counted from the
    plane of its slope. The seed of the noise is fixed."""
    empty_frame = empty_scene(recording)
    rng = np.random.default_rng(0)
    for _ in range(EMPTY_SWEEPS):
        for points in frame_points(empty_frame, area=recording.site, rng=rng):
            yield level_rows(points, recording.site.relief.slope)


def add_background(detector: Detector, site: Site) -> KnownBackground:
    """Return a detector that knows a site's scenery."""
    return KnownBackground(detector, site_background(site))


def site_background(site: Site) -> Background:
    """Return the background of a site's scenery, with z counted from the plane of its slope.

    Points are drawn at random, with a fixed seed, on all surfaces in the area, on average
    `POINTS_PER_FACE` on a surface as large as a side of a voxel."""
    crop = Crop.from_place(site)
    slope = site.relief.slope
    voxel = choose_voxel(crop)  # m
    mesh = build_scenery(site)
    # corners of triangles, z counted from the slope, (triangles, 3 corners, xyz)
    level_corners = level_rows(mesh.vertices, slope)[mesh.triangles]
    xmin, ymin, xmax, ymax = crop.area
    # triangles whose bounds meet the crop
    is_near = (level_corners.max(axis=1) >= [xmin, ymin, _MIN_HEIGHT_M]).all(axis=1)
    is_near &= (level_corners.min(axis=1) <= [xmax, ymax, crop.height]).all(axis=1)
    corners = mesh.vertices[mesh.triangles[is_near]]  # (triangles, 3 corners, xyz)
    rng = np.random.default_rng(0)
    # both edges from the first corner; their cross product is twice the triangle's area
    edges = corners[:, 1:] - corners[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
    point_counts = rng.poisson(area * (POINTS_PER_FACE / voxel**2))
    triangles = np.repeat(np.arange(len(point_counts)), point_counts)
    points = [np.zeros((0, 3), np.float32)]
    for start in range(0, len(triangles), _BATCH_POINTS):  # random points on all triangles
        batch = triangles[start : start + _BATCH_POINTS]
        weights = rng.random((len(batch), 2))  # share of each edge
        # points of the parallelogram beyond the triangle are mirrored into it
        weights = np.where(weights.sum(axis=1, keepdims=True) > 1, 1 - weights, weights)
        offsets = (weights[:, :, None] * edges[batch]).sum(axis=1)
        batch_points = (corners[batch, 0] + offsets).astype(np.float32)
        is_kept = crop.holds(batch_points, _MIN_HEIGHT_M)
        points.append(level_rows(batch_points[is_kept], slope))
    return Background.learn(np.concatenate(points), voxel)


def choose_voxel(crop: Crop) -> float:
    """Edge of voxels (m): the usual one, or larger so that an area has at most 2^26 voxels."""
    xmin, ymin, xmax, ymax = crop.area
    volume = (xmax - xmin) * (ymax - ymin) * (crop.height - _MIN_HEIGHT_M)
    return max(VOXEL_M, float(np.cbrt(volume / AREA_VOXELS)))
