"""Background of an empty site, and detectors that know it.

A point in or beside a voxel of the empty site shows the site. Any other point shows a road user,
whichever sensor sees it. Some parts of a site look like road users to a detector: a bush, a
container, a gap in a hedge. They stand there in every frame. Most points of a road user lie where
the empty site has none, so a detection with hardly any such points is dropped. This costs recall
only for objects that stood there while the site was learnt and never left."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from toolkit.arrays import Bool, Float, Float32, Float64, Mask, Points
from toolkit.boxes import count_points
from toolkit.detection.provenance import detector_origin
from toolkit.frame import empty_scene
from toolkit.geometry import level_rows
from toolkit.objects import Detections, Detector, UnionDetector, quick_detector
from toolkit.points import Crop, frame_points, join_clouds
from toolkit.rendering.static_scene import build_scenery
from toolkit.sites.site import Site

if TYPE_CHECKING:
    from toolkit.datasets.dataset import CoopDataset

VOXEL = 0.15  # m
PER_VOXEL = 2.0  # points on each square of a surface as large as a voxel's side
SWEEPS = 4  # sweeps of the empty scene, each with its own noise
_FLOOR = -1.0  # m: the ground may lie a little below its own plane
_AT_ONCE = 1 << 20
_MOST = 1 << 26  # voxels
MOST_VOXELS = 1 << 28


@dataclass(frozen=True)
class Background:
    """Voxels of the empty site and its ground height.

    origin: (3,) lowest corner of the grid (m); voxel: edge of a voxel (m); occupied: (nx, ny, nz),
    including one layer round the occupied voxels; cell: edge of a ground cell (m); ground: (kx, ky)
    height of the ground (m)."""

    origin: Float64[np.ndarray, "3"]
    voxel: float
    occupied: Bool[np.ndarray, "nx ny nz"]
    cell: float
    ground: Float64[np.ndarray, "kx ky"]

    @staticmethod
    def learn(points: Points, voxel: float = VOXEL, cell: float = 1.0) -> "Background":
        """Learn from points of the empty site, best several sweeps."""
        if not len(points):
            raise ValueError(
                "the background needs at least one point of the empty site, got none: crop less?"
            )
        size = np.ptp(points, axis=0)
        if not np.isfinite(points).all() or np.prod(size / voxel + 5.0) > MOST_VOXELS:
            raise ValueError(
                f"the background must be finite and small, got {size} m: crop to the area"
            )
        origin = points.min(axis=0).astype(np.float64) - 2 * voxel
        # at least 2, but for rounding
        index = np.maximum(((points - origin) / voxel).astype(np.int64), 2)
        occupied = np.zeros(index.max(axis=0) + 3, bool)
        occupied[tuple(index.T)] = True
        for axis in range(3):
            occupied |= np.roll(occupied, 1, axis) | np.roll(occupied, -1, axis)
        return Background(origin, voxel, occupied, cell, _ground(points, origin, cell))

    def holds(self, points: Points) -> Mask:
        """Mark points in or beside an empty-site voxel."""
        index = np.clip((points - self.origin) / self.voxel, 0, np.array(self.occupied.shape) - 1)
        # the outermost layer is never occupied
        return self.occupied[tuple(index.astype(np.int64).T)]

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the voxels and the ground."""
        return self.digest_settings(b"")

    def digest_settings(self, settings: bytes) -> str:
        """SHA-256 of settings and the background."""
        said = hashlib.sha256(settings)
        for part in (self.origin, self.voxel, self.occupied, self.cell, self.ground):
            said.update(repr(np.shape(part)).encode() + np.ascontiguousarray(part).tobytes())
        return said.hexdigest()

    def height(self, xy: Float[np.ndarray, "n 2"]) -> Float64[np.ndarray, " n"]:
        """Height of the ground at places (m)."""
        place = np.clip((xy - self.origin[:2]) / self.cell, 0, np.array(self.ground.shape) - 1)
        return self.ground[tuple(place.astype(np.int64).T)]


def _ground(points: np.ndarray, origin: np.ndarray, cell: float) -> Float64[np.ndarray, "kx ky"]:
    """Estimate the ground in cells: the 5 % quantile of their points, then the least within two
    cells."""
    from scipy.ndimage import minimum_filter

    place = ((points[:, :2] - origin[:2]) / cell).astype(np.int64)
    shape = place.max(axis=0) + 1
    key = place[:, 0] * shape[1] + place[:, 1]
    order = np.lexsort((points[:, 2], key))
    keys, first, count = np.unique(key[order], return_index=True, return_counts=True)
    low = points[order[first + count // 20], 2].astype(np.float64)
    ground = np.full(shape, np.inf)  # where it is unknown
    ground.ravel()[keys] = np.where(low > np.median(low) + 0.5, np.inf, low)
    while np.isinf(ground).any():
        ground = np.where(np.isinf(ground), minimum_filter(ground, 3, mode="nearest"), ground)
    return np.asarray(minimum_filter(ground, 5, mode="nearest"))


LEAST_NEW = 0.2  # least share of points in a box that must not be background


@dataclass(frozen=True)
class KnownBackground:
    """Detector that leaves out its detections of the background.

    Points are in the frame of the background. least: share, above 0 to 1, of the points in a
    detection's box that must not be background. Raises ValueError for another."""

    detector: Detector
    background: Background
    least: float = LEAST_NEW

    def __post_init__(self) -> None:
        if not 0 < self.least <= 1:
            raise ValueError(
                f"least must be a share above 0, at most 1, got {self.least}: such as {LEAST_NEW}"
            )

    @property
    def name(self) -> str:
        """Name by which commands take it."""
        return f"{detector_origin(self.detector)['detector']}+background"

    @property
    def labels(self) -> tuple[str, ...]:
        """Classes that the detector names, or AttributeError."""
        return self.detector.labels  # type: ignore[attr-defined]

    @property
    def digest(self) -> str:
        """SHA-256 of detector and background, or AttributeError."""
        own = self.detector.digest  # type: ignore[attr-defined]
        return hashlib.sha256(repr((own, self.background.digest, self.least)).encode()).hexdigest()

    @cached_property
    def _unsure(self) -> Detector:
        """Detector that leaves to `score_known` what it is not sure of, where it has that."""
        at_known_site = getattr(self.detector, "at_known_site", None)
        return self.detector if at_known_site is None else at_known_site()

    def quick(self) -> "KnownBackground":
        """Same detector as it compares (`quick_detector`)."""
        return replace(self, detector=quick_detector(self.detector))

    def __call__(self, points: Points, /) -> Detections:
        """Detect in the finite ones of points (n, 3)."""
        found = self._unsure(points)
        return self._keep(found, points, self._new(points)) if len(found) else found

    def unions(
        self, clouds: Sequence[Float[np.ndarray, "_ 3"]], unions: Bool[np.ndarray, "U C"]
    ) -> list[Detections]:
        """Detect in several unions of the same clouds."""
        if isinstance(self._unsure, UnionDetector):
            found = self._unsure.unions(clouds, unions)
        else:
            found = [self._unsure(join_clouds(clouds, union)) for union in unions]
        new = [self._new(cloud) for cloud in clouds]
        pairs = zip(found, unions, strict=True)
        return [
            self._keep(each, join_clouds(clouds, union), join_clouds(new, union))
            for each, union in pairs
        ]

    def _new(self, points: Float[np.ndarray, "p 3"]) -> Float[np.ndarray, "q 3"]:
        finite = points[np.isfinite(points).all(axis=1)]
        return finite[~self.background.holds(finite)]

    def _keep(
        self, found: Detections, points: Float[np.ndarray, "p 3"], new: Float[np.ndarray, "q 3"]
    ) -> Detections:
        """Keep detections with enough points outside the background."""
        there = count_points(points, found.boxes)
        outside = count_points(new, found.boxes)
        kept = found[(outside > 0) & (outside >= self.least * there)]
        surer = getattr(self.detector, "score_known", None)  # networks know what is left then
        return kept if surer is None else surer(kept)


def recording_background(recording: "CoopDataset") -> Background:
    """Learn the background of a recording: the scenery of its site if known, else what lies behind
    all that moves. Objects that park throughout become background."""
    if recording.site.solids:
        return site_background(recording.site)
    return Background.learn(np.concatenate(list(empty_sweeps(recording))))


def empty_sweeps(recording: "CoopDataset") -> Iterator[Float32[np.ndarray, "_ 3"]]:
    """Yield levelled points of four noisy sweeps without road users."""
    empty = empty_scene(recording)
    rng = np.random.default_rng(0)
    for _ in range(SWEEPS):
        for points in frame_points(empty, area=recording.site, rng=rng):
            yield level_rows(points, recording.site.relief.slope)


def add_background(detector: Detector, site: Site) -> KnownBackground:
    """Return a detector that knows a site's scenery."""
    return KnownBackground(detector, site_background(site))


def site_background(site: Site) -> Background:
    """Return the background of a site's scenery on level ground."""
    crop = Crop.of(site)
    slope = site.relief.slope
    voxel = choose_voxel(crop)
    mesh = build_scenery(site)
    level, (xmin, ymin, xmax, ymax) = level_rows(mesh.vertices, slope)[mesh.triangles], crop.area
    near = (level.max(axis=1) >= [xmin, ymin, _FLOOR]).all(axis=1)
    near &= (level.min(axis=1) <= [xmax, ymax, crop.height]).all(axis=1)
    corners = mesh.vertices[mesh.triangles[near]]
    rng = np.random.default_rng(0)
    edges = corners[:, 1:] - corners[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
    number = rng.poisson(area * (PER_VOXEL / voxel**2))
    owner = np.repeat(np.arange(len(number)), number)
    points = [np.zeros((0, 3), np.float32)]
    for start in range(0, len(owner), _AT_ONCE):  # random points on all triangles
        of = owner[start : start + _AT_ONCE]
        share = rng.random((len(of), 2))
        share = np.where(share.sum(axis=1, keepdims=True) > 1, 1 - share, share)
        some = (corners[of, 0] + (share[:, :, None] * edges[of]).sum(axis=1)).astype(np.float32)
        points.append(level_rows(some[crop.holds(some, _FLOOR)], slope))
    return Background.learn(np.concatenate(points), voxel)


def choose_voxel(crop: Crop) -> float:
    """Edge of voxels (m), coarser for a large area."""
    xmin, ymin, xmax, ymax = crop.area
    volume = (xmax - xmin) * (ymax - ymin) * (crop.height - _FLOOR)
    return max(VOXEL, float(np.cbrt(volume / _MOST)))
