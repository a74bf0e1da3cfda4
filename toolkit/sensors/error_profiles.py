"""Error profiles: the error terms of a recording's sensors under one name.

    paper      what the sensor models state, exact poses: the paper's 1.5 cm at every depth (section
               IV-A)
    surveyed   total station and registration afterwards: 0.05° and 1 cm, few mixed pixels, 0.5 %
               drop-out
    typical    0.2° and 3 cm, noise that grows with range, mixed pixels, glass, 2 % drop-out
    glare      a quarter of every image is blind; else typical
    typical-clock   clocks off by 50 ms (standard deviation), for frames 0.5 s apart or less; else
                    typical
    poor       0.5° and 5 cm, swaying poles, 5 % drop-out and more with range, dark paint, dead
               rows, rain; else typical

Depth cameras get the noise of a stereo pair (1 m baseline, 0.1 pixel), sensors that measure ranges
get a lidar's noise, both in addition to the model's. Add any other term in another profile:
`ErrorProfile("our-site", (*TYPICAL.terms, rain(25.0)))`.

Terms act in order: first the surface, then the air, then the sensor, then its believed pose. Every
term draws from a separate stream: adding one changes no other."""

import numpy as np

from toolkit.sensors import error_terms
from toolkit.sensors.error_profile import ErrorProfile
from toolkit.sensors.error_terms import (
    Calibration,
    DropOut,
    Glass,
    MixedPixels,
    OwnNoise,
    RangeNoise,
)

_NOISE = (
    OwnNoise(),
    error_terms.stereo_noise(baseline=1.0, focal=2000.0),
    RangeNoise(proportional=0.0005, measures="range"),
)
PAPER_ERRORS = ErrorProfile("paper", (OwnNoise(),))
_DARK = Glass(share=0.8), error_terms.Paint(share=0.2)
_BAD = *_DARK, DropOut(share=0.05, half_range=200.0), MixedPixels(share=0.2), error_terms.rain(10.0)
_NEAR_EXACT = (
    DropOut(share=0.005),
    MixedPixels(share=0.05),
    OwnNoise(),
    Calibration(float(np.deg2rad(0.05)), 0.01),
)
SURVEYED = ErrorProfile("surveyed", _NEAR_EXACT)
_USUAL = (
    Glass(share=0.8),
    DropOut(share=0.02),
    MixedPixels(share=0.2),
    *_NOISE,
    Calibration(float(np.deg2rad(0.2)), 0.03),
)
TYPICAL = ErrorProfile("typical", _USUAL)
_BADLY_PLACED = (
    Calibration(float(np.deg2rad(0.5)), 0.05),
    error_terms.PoleSway(float(np.deg2rad(0.05))),
)
POOR = ErrorProfile("poor", (*_BAD, error_terms.DeadRows(share=0.02), *_NOISE, *_BADLY_PLACED))
GLARE = ErrorProfile("glare", (*_USUAL, error_terms.BlindSector(share=0.25)))
TYPICAL_CLOCK = ErrorProfile("typical-clock", (*_USUAL, error_terms.ClockOffset(offset=0.05)))
PROFILES = {
    profile.name: profile
    for profile in (PAPER_ERRORS, SURVEYED, TYPICAL, GLARE, TYPICAL_CLOCK, POOR)
}


def find_profile(errors: ErrorProfile | str) -> ErrorProfile:
    """Find a profile by name; a profile is returned as it is.

    Raises ValueError that lists all names for an unknown one."""
    if isinstance(errors, str) and errors not in PROFILES:
        raise ValueError(
            f"unknown error profile {errors!r}: choose among {', '.join(PROFILES)}, or make your "
            "own"
        )
    return PROFILES[errors] if isinstance(errors, str) else errors


def only_own_noise(errors: ErrorProfile) -> bool:
    """True if a profile has the noise of the sensor models and nothing else."""
    return errors.terms == PAPER_ERRORS.terms


def check_drawn(errors: ErrorProfile, seed: int | None) -> None:
    """Raise ValueError if seed is None, unless the profile has only the sensor models' noise."""
    if seed is None and not only_own_noise(errors):
        raise ValueError(
            f"errors {errors.name!r} are drawn from a seed, got noise_seed None: give one"
        )
