"""Background of a site's scenery, or of what lies behind all that moves in a recording."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from toolkit.arrays import Float, Float32
from toolkit.datasets.dataset import CoopDataset
from toolkit.detection.background import VOXEL, Background, KnownBackground
from toolkit.frame import empty_scene
from toolkit.geometry import level_rows
from toolkit.mesh import Mesh
from toolkit.objects import Detector
from toolkit.points import Crop, frame_points
from toolkit.rendering.static_scene import build_scenery
from toolkit.sites.site import Site

PER_VOXEL = 2.0  # points on each square of a surface as large as a voxel's side
_SWEEPS = 4  # sweeps of the empty scene, each with its own noise
_FLOOR = -1.0  # m: the ground may lie a little below its own plane
_AT_ONCE = 1 << 20
_MOST = 1 << 26  # voxels


def recording_background(recording: CoopDataset) -> Background:
    """Learn the background of a recording: the scenery of its site if known, else what lies behind all that moves.
    Objects that park throughout become background.
    """
    if recording.site.solids:
        return site_background(recording.site)
    return Background.learn(np.concatenate(list(empty_sweeps(recording))))


def empty_sweeps(recording: CoopDataset) -> Iterator[Float32[np.ndarray, "_ 3"]]:
    """Yield cropped points of each sensor without road users. Four times over, with noise. The ground is levelled."""
    empty, rng = empty_scene(recording), np.random.default_rng(0)
    for _ in range(_SWEEPS):
        for points in frame_points(empty, area=recording.site, rng=rng):
            yield level_rows(points, recording.site.relief.slope)


def add_background(detector: Detector, site: Site) -> KnownBackground:
    """Return a detector that knows a site's scenery."""
    return KnownBackground(detector, site_background(site))


def site_background(site: Site) -> Background:
    """Return the background of all that stands still in a site's area up to its height, with the ground levelled."""
    crop, slope = Crop.of(site), site.relief.slope
    voxel, mesh = choose_voxel(crop), build_scenery(site)
    corners, (xmin, ymin, xmax, ymax) = level_rows(mesh.vertices, slope)[mesh.triangles], crop.area
    near = (corners.max(axis=1) >= [xmin, ymin, _FLOOR]).all(axis=1)
    near &= (corners.min(axis=1) <= [xmax, ymax, crop.height]).all(axis=1)
    surfaces = _on_surfaces(Mesh(mesh.vertices, mesh.triangles[near]), voxel)
    points = [level_rows(some[crop.holds(some, _FLOOR)], slope) for some in surfaces]
    return Background.learn(np.concatenate([np.zeros((0, 3), np.float32), *points]), voxel)


def choose_voxel(crop: Crop) -> float:
    """Edge of a background's voxels (m), coarser than `VOXEL` for a grid that would take more than 64 MB."""
    xmin, ymin, xmax, ymax = crop.area
    volume = (xmax - xmin) * (ymax - ymin) * (crop.height - _FLOOR)
    return max(VOXEL, float(np.cbrt(volume / _MOST)))


def _on_surfaces(mesh: Mesh, voxel: float) -> Iterator[Float[np.ndarray, "n 3"]]:
    """Yield random points on all triangles of a mesh, `PER_VOXEL` per voxel side on average."""
    rng = np.random.default_rng(0)
    corners = mesh.vertices[mesh.triangles]
    edges = corners[:, 1:] - corners[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2
    number = rng.poisson(area * (PER_VOXEL / voxel**2))
    owner = np.repeat(np.arange(len(number)), number)
    for start in range(0, len(owner), _AT_ONCE):
        of = owner[start : start + _AT_ONCE]
        share = rng.random((len(of), 2))
        share = np.where(share.sum(axis=1, keepdims=True) > 1, 1 - share, share)
        yield (corners[of, 0] + (share[:, :, None] * edges[of]).sum(axis=1)).astype(np.float32)
