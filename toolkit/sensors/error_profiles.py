"""Error profiles: the error terms of a recording's sensors under one name.

    paper      what the sensor models say, exact poses: the paper's 1.5 cm at every depth (section
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
that of a lidar, both beside the model's own. Add any other term in a profile of your own:
`ErrorProfile("our-site", (*TYPICAL.terms, rain(25.0)))`.

Terms act in order: first what a surface sends back, then what lies between, then what the sensor
makes of it, then where it is believed to be. Every term draws from a stream of its own: adding one
changes no other."""

import zlib
from collections import Counter
from dataclasses import asdict, dataclass, is_dataclass
from functools import cached_property

import numpy as np

from toolkit.runtime.cache import make_key
from toolkit.sensors import error_terms
from toolkit.sensors.error_terms import (
    Calibration,
    DropOut,
    Glass,
    MixedPixels,
    OwnNoise,
    RangeNoise,
)
from toolkit.sensors.readings import Draws, ErrorTerm, Reading, TrueImage


@dataclass(frozen=True)
class ErrorProfile:
    """Error terms under a name, in the order they act. Raises ValueError for a term that is no
    `ErrorTerm`."""

    name: str
    terms: tuple[ErrorTerm, ...]

    def __post_init__(self) -> None:
        if not self.name:
            raise ValueError(
                "an error profile needs a name, got an empty one: results say which it was"
            )
        for term in self.terms:
            if not (is_dataclass(term) and isinstance(term, ErrorTerm)) or isinstance(term, type):
                raise ValueError(
                    f"terms must be error terms such as Calibration(), got {term!r}: see ErrorTerm"
                )

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all terms and their numbers, whatever the name."""
        described = []
        for term in self.terms:
            numbers = {
                k: v.item() if isinstance(v, np.generic) else v for k, v in asdict(term).items()
            }
            described.append([type(term).__module__, type(term).__qualname__, numbers])
        return make_key(described).hex()

    @property
    def modules(self) -> list[str]:
        """Modules that define the terms."""
        return sorted({type(term).__module__ for term in self.terms})

    @property
    def needs_velocities(self) -> bool:
        """True if a term depends on the speed of objects."""
        return any(term.needs_velocities for term in self.terms)

    @property
    def origin(self) -> dict[str, str]:
        """Name and digest, for results."""
        return {"profile": self.name, "digest": self.digest}

    def read(self, truth: TrueImage, *, seed: int, sensor: int, frame: int) -> Reading:
        """Apply all terms to a true image. seed: of the recording's errors; sensor, frame: their
        numbers."""
        reading = Reading.of(truth)
        before = Counter[str]()
        for term in self.terms:
            kind = type(term).__qualname__
            stream = zlib.crc32(f"{kind} {before[kind]}".encode())
            before[kind] += 1
            reading = term.apply(reading, Draws(seed, sensor, frame, stream))
        return reading


def _degrees(angle_deg: float) -> float:
    return float(np.deg2rad(angle_deg))


_NOISE = (
    OwnNoise(),
    error_terms.stereo_noise(baseline=1.0, focal=2000.0),
    RangeNoise(proportional=0.0005, measures="range"),
)

PAPER_ERRORS = ErrorProfile("paper", (OwnNoise(),))
_NEAR_EXACT = (
    DropOut(share=0.005),
    MixedPixels(share=0.05),
    OwnNoise(),
    Calibration(_degrees(0.05), 0.01),
)
SURVEYED = ErrorProfile("surveyed", _NEAR_EXACT)
_USUAL = (
    Glass(share=0.8),
    DropOut(share=0.02),
    MixedPixels(share=0.2),
    *_NOISE,
    Calibration(_degrees(0.2), 0.03),
)
TYPICAL = ErrorProfile("typical", _USUAL)
_DARK = Glass(share=0.8), error_terms.Paint(share=0.2)
_BAD = *_DARK, DropOut(share=0.05, half_range=200.0), MixedPixels(share=0.2), error_terms.rain(10.0)
_BADLY_PLACED = Calibration(_degrees(0.5), 0.05), error_terms.PoleSway(_degrees(0.05))
POOR = ErrorProfile("poor", (*_BAD, error_terms.DeadRows(share=0.02), *_NOISE, *_BADLY_PLACED))
GLARE = ErrorProfile("glare", (*_USUAL, error_terms.BlindSector(share=0.25)))
TYPICAL_CLOCK = ErrorProfile("typical-clock", (*_USUAL, error_terms.ClockOffset(offset=0.05)))
PROFILES = {
    profile.name: profile
    for profile in (PAPER_ERRORS, SURVEYED, TYPICAL, GLARE, TYPICAL_CLOCK, POOR)
}


def find_profile(errors: ErrorProfile | str) -> ErrorProfile:
    """Find a profile by name; return a profile itself. Raises ValueError that lists all."""
    if isinstance(errors, str) and errors not in PROFILES:
        raise ValueError(
            f"unknown error profile {errors!r}: choose among {', '.join(PROFILES)}, or make your "
            "own"
        )
    return PROFILES[errors] if isinstance(errors, str) else errors


def only_own_noise(errors: ErrorProfile) -> bool:
    """True if a profile adds nothing to the noise of the sensor models."""
    return errors.terms == PAPER_ERRORS.terms


def check_drawn(errors: ErrorProfile, seed: int | None) -> None:
    """Raise ValueError if errors would be drawn without a seed."""
    if seed is None and not only_own_noise(errors):
        raise ValueError(
            f"errors {errors.name!r} are drawn from a seed, got noise_seed None: give one"
        )
