"""`Outlook`: what the map says of candidates, each seen from where it hangs and how it is headed.

Every candidate has a raster of its own, over cells that all share, so that it shows which of them see the same: how
many of its rays would fall on a vehicle in each cell, what solids leave to be seen of it, how much traffic is in
between, how far off it is, and whether it is looked at along its course (1) or across (0). A cell beside its field of
view has no rays. Nothing is simulated or rendered: of a pool it takes a fraction of a millisecond for each candidate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from placement_env.candidates.aim import aims
from placement_env.candidates.candidates import Candidates
from placement_env.candidates.outlook.ground_plan import RASTER_CELLS, GroundPlan, ground_plan
from placement_env.candidates.outlook.height_map import height_map
from placement_env.candidates.outlook.ray_density import bins, ray_angles, ray_density
from placement_env.candidates.outlook.sight_lines import MIDDLE, SightLines, sight_lines
from toolkit.arrays import Float32, Float64
from toolkit.sensors.model import SensorModel
from toolkit.sites.site import Site

VIEW = ("rays", "clear", "between", "distance", "along")
CANDIDATE_FEATURES = (
    "x",
    "y",
    "height",
    "cos heading",
    "sin heading",
    "tilt",
    "field of view",
    "rays",
    "ground rays",
    "solid rays",
)
FACE = 4.0  # m² of a vehicle that a sensor looks at
REACH_ASIDE = 1.5  # m that a vehicle reaches to either side, so that it may be seen in part
MOST_RAYS = 1e4  # on a vehicle
FARTHEST = 150.0  # m
BLUR = 0.06  # m of relief between ground that is hardly ever sent and ground that nearly always is
COARSE = 2  # every such row and column of cells is looked at for what is sent


@dataclass(frozen=True, eq=False)
class Outlook:
    """Of C candidates. plan: the map; view: `VIEW` of each candidate and used cell, all in 0..1; features:
    `CANDIDATE_FEATURES` of each candidate, in -1..1."""

    plan: GroundPlan
    view: Float32[np.ndarray, "C Q 5"]
    features: Float32[np.ndarray, "C 10"]


def outlook(site: Site, candidates: Candidates) -> Outlook:
    """What the map of a site says of candidates there."""
    plan, heights = ground_plan(site), height_map(site)
    positions = np.array([sensor.position for sensor in candidates.sensors]).reshape(-1, 3)
    places, which = np.unique(positions.round(6), axis=0, return_inverse=True)
    which = which.ravel()
    lines = sight_lines(plan, heights, places)
    view = np.empty((len(candidates), len(plan.used), len(VIEW)), np.float32)
    raised = lifted(site, plan)
    sent = np.zeros((len(candidates), 2))
    for model in dict.fromkeys(sensor.model for sensor in candidates.sensors):
        rows = np.array([c for c, sensor in enumerate(candidates.sensors) if sensor.model == model])
        turned = np.array([candidates.sensors[c].pose[:3, :3] for c in rows]) @ model.body_SE3_sensor[:3, :3].T
        view[rows] = _view(plan, model, positions[rows], turned, SightLines(*(each[which[rows]] for each in lines)))
        sent[rows] = _sent(plan, raised, model, positions[rows], turned)
    return Outlook(plan, view, _features(site, candidates, positions, sent))


def lifted(site: Site, plan: GroundPlan) -> Float64[np.ndarray, " P"]:
    """How likely a point on the ground of each cell is measured above the plane of the street, and so is sent: its
    relief is known, and noise lifts half of what is level."""
    above = plan.ground - site.plane(plan.centres)
    return np.clip(0.5 + above / BLUR, 0, 1)


def rays_at(
    model: SensorModel, offsets: Float32[np.ndarray, "n m 3"], turned: Float64[np.ndarray, "n 3 3"]
) -> tuple[Float32[np.ndarray, "n m"], Float32[np.ndarray, "n m"]]:
    """Rays per m² that lies square to them at offsets from sensors, whose bodies are turned so, mean of there and
    `REACH_ASIDE` to either side; and the distances."""
    distance = np.sqrt(np.einsum("nmk,nmk->nm", offsets, offsets))
    azimuth, elevation = ray_angles(offsets @ turned.astype(np.float32))
    beside = np.minimum(REACH_ASIDE / np.maximum(distance, 1), np.pi / 8)
    density = ray_density(model)
    per_steradian = np.mean([density[bins(azimuth + k * beside, elevation)] for k in (-1, 0, 1)], axis=0)
    return per_steradian / np.maximum(distance, 1) ** 2 * (distance < model.max_range), distance


def _view(
    plan: GroundPlan, model: SensorModel, positions: np.ndarray, turned: np.ndarray, lines: SightLines
) -> Float32[np.ndarray, "n Q 5"]:
    targets = np.column_stack([plan.centres[plan.used], plan.ground[plan.used] + MIDDLE])
    offsets = (targets - positions[:, None]).astype(np.float32)
    rays, distance = rays_at(model, offsets, turned)
    x, y = offsets[..., 0], offsets[..., 1]
    square = np.maximum(x * x + y * y, 1)
    course = plan.course[plan.used].astype(np.float32)
    columns = {
        "rays": np.log1p(np.minimum(FACE * rays, MOST_RAYS)) / np.log1p(MOST_RAYS),
        "clear": lines.clear,
        "between": lines.between / (lines.between + 1),
        "distance": np.minimum(distance / FARTHEST, 1),
        "along": 0.5 + 0.5 * (course[:, 0] * (x * x - y * y) + course[:, 1] * 2 * x * y) / square,
    }
    return np.stack([columns[name] for name in VIEW], axis=2).astype(np.float32)


def _sent(
    plan: GroundPlan, raised: np.ndarray, model: SensorModel, positions: np.ndarray, turned: np.ndarray
) -> Float64[np.ndarray, "n 2"]:
    """Rays that would fall on ground of the area that is higher than the street, and on solids there, if nothing stood
    in between."""
    some = np.flatnonzero((np.arange(RASTER_CELLS) % COARSE == 0)[:, None] & (np.arange(RASTER_CELLS) % COARSE == 0))
    spots = np.column_stack([plan.centres[some], plan.ground[some]])
    flat, upright = (plan.size.prod() * COARSE**2 * each[some] for each in (raised, plan.shares[:, 2]))
    offsets = (spots - positions[:, None]).astype(np.float32)
    rays, distance = rays_at(model, offsets, turned)
    steep = np.abs(offsets[..., 2]) / np.maximum(distance, 1)
    return np.stack([(rays * steep) @ flat, rays @ upright], axis=1)


def _features(
    site: Site, candidates: Candidates, positions: np.ndarray, sent: np.ndarray
) -> Float32[np.ndarray, "C 10"]:
    headings, tilts = aims(candidates.sensors)
    middle, size = (site.area[:2] + site.area[2:]) / 2, site.area[2:] - site.area[:2]
    x, y = ((positions[:, :2] - middle) / size).T
    models = [sensor.model for sensor in candidates.sensors]
    columns = {
        "x": x,
        "y": y,
        "height": (positions[:, 2] - site.ground(positions[:, :2])) / 20,
        "cos heading": np.cos(headings),
        "sin heading": np.sin(headings),
        "tilt": tilts / (np.pi / 2),
        "field of view": np.array([model.horizontal_fov for model in models]) / (2 * np.pi),
        "rays": np.log1p([float(np.prod(model.shape)) for model in models]) / 15,
        "ground rays": np.log1p(sent[:, 0]) / 15,
        "solid rays": np.log1p(sent[:, 1]) / 15,
    }
    return np.clip(np.stack([columns[name] for name in CANDIDATE_FEATURES], axis=1), -1, 1).astype(np.float32)
