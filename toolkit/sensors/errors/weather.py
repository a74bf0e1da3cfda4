"""Rain, fog and snow: near returns from what falls or hovers, and returns that are lost on their way.

Extinction takes exp(-2 · extinction · R) of what a surface at range R returns (Beer, Lambert); this share of returns
survives. Extinction at 905 nm in dB per km:

    rain   1.076 · r^0.67, r in mm/h                        (Carbonneau and Wisely, 1998; Recommendation ITU-R P.1814)
    snow   (5.42e-5 · 905 + 5.496) · s^1.38 if dry, (1.02e-4 · 905 + 3.786) · s^0.72 if wet, s in mm/h   (ITU-R P.1814)
    fog    3.912 per metre over the visibility at 2 % contrast                                           (Koschmieder)

Near returns come with a rate that falls with range, as the echo of a drop falls steeply and the beam widens: per metre
`rate · exp(-(r - 0.3 m) / reach)`, so that of rays that meet no surface `share` return from the air, and of those that
do, as many as meet a drop before it. That most false returns lie within some 10 m is found in rain by Filgueira et al.
(Quantifying the influence of rain in LiDAR performance, Measurement 95, 2017), in fog by Bijelic, Gruber and Ritter (A
benchmark for lidar sensors in fog, IV 2018), in snow by Hahner et al. (LiDAR snowfall simulation, CVPR 2022). Their
shares differ by sensor: those that `rain`, `fog` and `snow` take are assumptions of ours, to be replaced where known.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from toolkit.sensors.errors.draws import Draws
from toolkit.sensors.errors.profile import check_least, check_share
from toolkit.sensors.errors.reading import Reading
from toolkit.sensors.model import NEAR

PER_METRE_OF_DB_PER_KM = np.log(10) / 10 / 1000


@dataclass(frozen=True)
class Weather:
    """extinction: per metre; share: of rays into the open that return from the air, below 1; reach: by which the rate
    of such returns falls to 1/e (m)."""

    needs_velocities: ClassVar[bool] = False

    extinction: float = 0.0
    share: float = 0.0
    reach: float = 8.0

    def __post_init__(self) -> None:
        check_share(self, "share")
        check_least(self, extinction=0, reach=1e-3)
        if self.share == 1:
            raise ValueError("share of Weather must be below 1, got 1: nothing else would ever be seen")

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """The reading in this weather."""
        if not (self.extinction or self.share):
            return reading
        rng, truth = draws.of_frame(), reading.truth
        survives, met = rng.random(reading.measurement.shape), rng.random(reading.measurement.shape)
        ranges = np.where(reading.valid, reading.measurement * truth.ray_lengths, np.float32(np.inf))
        arrives = np.exp(-2 * self.extinction * np.where(reading.valid, ranges, 0))
        reading = reading.without(reading.valid & (survives >= arrives))
        if not self.share:
            return reading
        left = 1 + np.log1p(-met) / -np.log1p(-self.share)  # exp(-(r - NEAR) / reach) at the first drop; none below 0
        drop = NEAR - self.reach * np.log(np.maximum(left, 1e-12))
        from_air = (left > 0) & (drop < ranges) & (drop < truth.sensor.model.max_range)
        in_front = (drop / truth.ray_lengths).astype(np.float32)
        return reading.measuring(np.where(from_air, in_front, reading.measurement))


def rain(rate: float) -> Weather:
    """Of some mm/h: 2.5 light, 10 heavy, 50 a cloudburst. Of rays into the open 0.3 % per mm/h return from a drop.

    >>> f"{rain(10.0).extinction * 1000:.3f} {rain(10.0).share:.4f}"
    '1.159 0.0296'
    """
    return Weather(PER_METRE_OF_DB_PER_KM * 1.076 * _rate(rate) ** 0.67, 1 - np.exp(-0.003 * rate), 8.0)


def snow(rate: float, *, wet: bool = False) -> Weather:
    """Of some mm/h of water: 1 light, 4 heavy. Of rays into the open 4 % per mm/h return from a flake."""
    dry_law, wet_law = (5.42e-5 * 905 + 5.496, 1.38), (1.02e-4 * 905 + 3.786, 0.72)
    factor, power = wet_law if wet else dry_law
    return Weather(PER_METRE_OF_DB_PER_KM * factor * _rate(rate) ** power, 1 - np.exp(-0.04 * rate), 6.0)


def fog(visibility: float) -> Weather:
    """In which one sees so far (m). Of rays into the open 1 - exp(-5 m / visibility) return from the fog, most within a
    tenth of the visibility."""
    if not visibility > 0:
        raise ValueError(f"visibility must be above 0 m, got {visibility}")
    return Weather(3.912 / visibility, 1 - np.exp(-5 / visibility), visibility / 10)


def _rate(rate: float) -> float:
    if not 0 <= rate < np.inf:
        raise ValueError(f"a rate must be a number of mm/h from 0 on, got {rate}")
    return rate
