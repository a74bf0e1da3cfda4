"""What vehicles do not send back: window glass, and dark or wet paint.

Glass reflects 4 % of a ray at each face (Fresnel), away from the sensor; what passes returns from seats, trims or not
at all (Foster, Sun, Park, Kuipers: VisAGGE, visible angle grid for glass environments, ICRA 2013). Black paint returns
some tenth of what white does at 905 nm; a wet surface is darker than a dry one, since light is trapped under the film
of water (Lekner and Dorf: Why some things are darker when wet, Applied Optics 27, 1988).

Approximation, from boxes alone: the windows of a vehicle are the band of its body between `lower` and `upper` of its
height; pillars are a share of it, drawn pixel by pixel. It is right for saloons, estates and hatchbacks; vans have less
glass than this, heavy vehicles and two-wheelers are taken to have none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from toolkit.arrays import Bool, Float64, Int64
from toolkit.objects import HEAVY, VEHICLE
from toolkit.sensors.errors.draws import Draws
from toolkit.sensors.errors.drop_out import chance_of_return
from toolkit.sensors.errors.profile import check_least, check_share
from toolkit.sensors.errors.reading import Reading, TrueImage


@dataclass(frozen=True)
class Glass:
    """share: of the window band that is glass, the rest being pillars; lower, upper: the band, as shares of a vehicle's
    height; behind: share of the rays through glass that return from the inside, anywhere on their way through the box
    with the same probability; the others return nothing."""

    needs_velocities: ClassVar[bool] = False

    share: float = 0.0
    lower: float = 0.62
    upper: float = 0.93
    behind: float = 0.3

    def __post_init__(self) -> None:
        check_share(self, "share", "lower", "upper", "behind")
        if not self.lower < self.upper:
            raise ValueError(f"the window band must have lower < upper, got {self.lower} and {self.upper}")

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """The reading through the windows."""
        if not self.share:
            return reading
        rng, shape = draws.of_frame(), reading.measurement.shape
        pane, inside, way = rng.random(shape) < self.share, rng.random(shape) < self.behind, rng.random(shape)
        glass = self.band(reading.truth) & pane & reading.valid
        pixels = np.flatnonzero(glass & inside)
        through = np.zeros(glass.size)
        through[pixels] = way.ravel()[pixels] * _way_through(reading.truth, pixels)
        deeper = reading.measurement + (through.reshape(shape) / reading.truth.ray_lengths).astype(np.float32)
        return reading.measuring(np.where(glass & inside, deeper, reading.measurement)).without(glass & ~inside)

    def band(self, truth: TrueImage) -> Bool[np.ndarray, "rows columns"]:
        """Which pixels show the window band of a vehicle."""
        owners = truth.owners.ravel()
        pixels = np.flatnonzero(owners >= 0)
        pixels = pixels[truth.objects.labels[owners[pixels]] == VEHICLE]
        boxes = truth.objects.boxes[owners[pixels]]
        height = (truth.points[pixels, 2] - boxes[:, 2]) / boxes[:, 5] + 0.5
        band = np.zeros(owners.size, np.bool_)
        band[pixels] = (height > self.lower) & (height < self.upper)
        return band.reshape(truth.measurement.shape)


@dataclass(frozen=True)
class Paint:
    """share: of vehicles, heavy ones among them, that are dark, by track id, for all sensors and frames alike;
    dark: their reflectivity against that of others; wet: that of every vehicle against when dry, 1 for dry;
    half_range, steepness: see `toolkit.sensors.errors.drop_out`, for a vehicle that is not dark.

    Recordings without track ids draw anew in each frame.
    """

    needs_velocities: ClassVar[bool] = False

    share: float = 0.0
    dark: float = 0.1
    wet: float = 1.0
    half_range: float = 150.0
    steepness: float = 2.0

    def __post_init__(self) -> None:
        check_share(self, "share", "dark", "wet")
        check_least(self, half_range=1e-3, steepness=0)

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """The reading without what paint swallowed: of a dark or wet vehicle, what returns else is lost with 1 less the
        ratio of both chances, so that a dry bright one loses nothing here."""
        truth, shape = reading.truth, reading.measurement.shape
        if not (self.share or self.wet < 1) or not len(truth.objects):
            return reading
        painted = np.isin(truth.objects.labels, (VEHICLE, HEAVY))
        is_dark = (draws.of_objects(truth.objects.ids) < self.share) & painted
        reflectivity = np.where(painted, self.wet, 1.0) * np.where(is_dark, self.dark, 1.0)
        of_pixel = np.append(reflectivity, 1.0)[truth.owners]
        law = truth.ranges, truth.cosines, self.half_range, self.steepness
        kept = chance_of_return(*law, of_pixel) / chance_of_return(*law)
        return reading.without(draws.of_frame().random(shape) >= kept)


def _way_through(truth: TrueImage, pixels: Int64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
    """How far (m) the rays of some pixels, each on an object, go on until they leave its box."""
    owners, points = truth.owners.ravel()[pixels], truth.points[pixels]
    x, y, z, length, width, height, yaw = truth.objects.boxes[owners].T
    rays = truth.sensor.world_rays.T[pixels].astype(np.float64)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    along, across = np.stack([np.cos(yaw), np.sin(yaw)]), np.stack([-np.sin(yaw), np.cos(yaw)])
    from_middle = points - np.stack([x, y, z], axis=1)
    here, ray = (
        np.stack([(v[:, :2].T * along).sum(axis=0), (v[:, :2].T * across).sum(axis=0), v[:, 2]], axis=1)
        for v in (from_middle, rays)
    )
    half = np.stack([length, width, height], axis=1) / 2
    ray = np.where(np.abs(ray) < 1e-9, 1e-9, ray)
    return np.maximum(((np.copysign(half, ray) - here) / ray).min(axis=1), 0.0)
