"""Error profile: the error terms of a recording's sensors under one name."""

import zlib
from collections import Counter
from dataclasses import asdict, dataclass, is_dataclass
from functools import cached_property

import numpy as np

from toolkit.runtime.cache import make_key
from toolkit.sensors.error_terms import Calibration
from toolkit.sensors.readings import Draws, ErrorTerm, Reading, TrueImage

USUAL_DISTANCE_M = 15.0  # from a road user to the sensor that sees it best


@dataclass(frozen=True)
class ErrorProfile:
    """Error terms under a name, in the order in which they act.

    Raises ValueError for an empty name and for a term that is no `ErrorTerm`."""

    name: str
    terms: tuple[ErrorTerm, ...]

    def __post_init__(self) -> None:
        """Raise ValueError for an empty name, and for a term that is no error term."""
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
        """Hexadecimal SHA-256 of all terms and their numbers, whatever the profile's name."""
        descriptions = []
        for term in self.terms:
            # NumPy's numbers as Python's
            numbers = {
                name: value.item() if isinstance(value, np.generic) else value
                for name, value in asdict(term).items()
            }
            descriptions.append([type(term).__module__, type(term).__qualname__, numbers])
        return make_key(descriptions).hex()

    @property
    def modules(self) -> list[str]:
        """Sorted names of the Python modules that define the terms."""
        return sorted({type(term).__module__ for term in self.terms})

    @property
    def needs_velocities(self) -> bool:
        """True if a term depends on the velocity of objects."""
        return any(term.needs_velocities for term in self.terms)

    @property
    def place_error(self) -> float:
        """Expected constant error (m), the same in all frames, of places along one direction.

        Places are `USUAL_DISTANCE_M` from one sensor with an error of calibration, and the
        direction is across its line of sight. Other terms vary in time, and are left out."""
        variance = 0.0
        for term in self.terms:
            if isinstance(term, Calibration):
                turned = term.rotation * USUAL_DISTANCE_M
                # deviations over three axes together, of which this is one
                variance += (turned**2 + term.translation**2) / 3
        return float(np.sqrt(2 / np.pi * variance))  # mean of a normal error's size

    @property
    def origin(self) -> dict[str, str]:
        """Name and digest of the profile, to be kept with results."""
        return {"profile": self.name, "digest": self.digest}

    def read(self, truth: TrueImage, *, seed: int, sensor: int, frame: int) -> Reading:
        """Apply all terms to a true image, and return what the sensor reports.

        seed: seed of the recording's errors; sensor, frame: their numbers in the recording. Random
        numbers depend on all three."""
        reading = Reading.from_truth(truth)
        earlier_terms = Counter[str]()
        for term in self.terms:
            kind = type(term).__qualname__
            # depends on the class and on its number among terms of this class, so that other terms
            # do not change it
            stream = zlib.crc32(f"{kind} {earlier_terms[kind]}".encode())
            earlier_terms[kind] += 1
            draws = Draws(seed=seed, sensor=sensor, frame=frame, term=stream)
            reading = term.apply(reading, draws)
        return reading
