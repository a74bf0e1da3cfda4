"""The named error profiles, from none but the paper's noise to a poor deployment.

    paper      what the sensor models say, exact poses: the paper's 1.5 cm at every depth (section IV-A)
    surveyed   total station and registration afterwards: 0.05° and 1 cm, few mixed pixels, 0.5 % drop-out
    typical    0.2° and 3 cm, noise that grows with range, mixed pixels, glass, 2 % drop-out
    poor       0.5° and 5 cm, swaying poles, 5 % drop-out and more with range, dark paint, dead rows, rain; else typical

Depth cameras get the noise of a stereo pair (1 m baseline, 0.1 pixel), sensors that measure ranges that of a lidar,
both beside the model's own. Why these numbers: see the modules of the terms. A clock's offset is in none of them, since
recordings 5 s apart cannot have it: add `ClockOffset` to a profile of your own.
"""

from __future__ import annotations

import numpy as np

from toolkit.sensors.errors.drop_out import DeadRows, DropOut
from toolkit.sensors.errors.mixed_pixels import MixedPixels
from toolkit.sensors.errors.pose_errors import Calibration, PoleSway
from toolkit.sensors.errors.profile import ErrorProfile
from toolkit.sensors.errors.range_noise import OwnNoise, RangeNoise, stereo_noise
from toolkit.sensors.errors.vehicle_surfaces import Glass, Paint
from toolkit.sensors.errors.weather import rain


def _degrees(angle_deg: float) -> float:
    return float(np.deg2rad(angle_deg))


_LIDAR = RangeNoise(proportional=0.0005, measures="range")

PAPER_ERRORS = ErrorProfile("paper", (OwnNoise(),))
SURVEYED = ErrorProfile(
    "surveyed",
    (
        DropOut(share=0.005),
        MixedPixels(share=0.05),
        OwnNoise(),
        Calibration(_degrees(0.05), 0.01),
    ),
)
TYPICAL = ErrorProfile(
    "typical",
    (
        Glass(share=0.8),
        DropOut(share=0.02),
        MixedPixels(share=0.2),
        OwnNoise(),
        stereo_noise(baseline=1.0, focal=2000.0),
        _LIDAR,
        Calibration(_degrees(0.2), 0.03),
    ),
)
POOR = ErrorProfile(
    "poor",
    (
        Glass(share=0.8),
        Paint(share=0.2),
        DropOut(share=0.05, half_range=200.0),
        MixedPixels(share=0.2),
        rain(10.0),
        DeadRows(share=0.02),
        OwnNoise(),
        stereo_noise(baseline=1.0, focal=2000.0),
        _LIDAR,
        Calibration(_degrees(0.5), 0.05),
        PoleSway(_degrees(0.05)),
    ),
)
PROFILES = {profile.name: profile for profile in (PAPER_ERRORS, SURVEYED, TYPICAL, POOR)}


def profile_named(name: str) -> ErrorProfile:
    """The profile of that name. Raises ValueError that lists what there is."""
    if name not in PROFILES:
        raise ValueError(f"there is no error profile {name!r}: choose among {', '.join(PROFILES)}, or make your own")
    return PROFILES[name]


def profile_of(errors: ErrorProfile | str) -> ErrorProfile:
    """A profile, or the one of that name."""
    return profile_named(errors) if isinstance(errors, str) else errors


def only_own_noise(errors: ErrorProfile) -> bool:
    """Whether a profile adds nothing to the noise of the sensor models, as `paper`, whatever it is called."""
    return errors.terms == PAPER_ERRORS.terms


def check_drawn(errors: ErrorProfile, seed: int | None) -> None:
    """ValueError where errors are to be drawn without a seed."""
    if seed is None and not only_own_noise(errors):
        raise ValueError(f"errors {errors.name!r} are drawn from a seed, got noise_seed None: give one")
