"""`ErrorProfile`: the error terms of a recording's sensors under one name, and `ErrorTerm`, what a term is.

A term is a frozen dataclass of numbers that satisfies `ErrorTerm`; a profile of one's own is

    ErrorProfile("our-site", (*TYPICAL.terms, rain(25.0)))

Terms act in the order they stand in: first what a surface sends back, then what lies between, then what the sensor
makes of it, then where it is believed to be. Every term draws from a stream of its own: adding one changes no other.
"""

from __future__ import annotations

import zlib
from collections import Counter
from dataclasses import asdict, dataclass, is_dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from toolkit.runtime.cache import key_of
from toolkit.sensors.errors.draws import Draws
from toolkit.sensors.errors.reading import Reading, TrueImage


@runtime_checkable
class ErrorTerm(Protocol):
    """One kind of error."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def needs_velocities(self) -> bool:
        """Whether it has to be known how fast the objects are."""

    def apply(self, reading: Reading, draws: Draws) -> Reading:
        """The reading with this error; the same reading where the term has no strength."""


@dataclass(frozen=True)
class ErrorProfile:
    """name: what results say; terms: in the order they act. Raises ValueError where a term is none."""

    name: str
    terms: tuple[ErrorTerm, ...]

    def __post_init__(self) -> None:
        if not self.name:
            raise ValueError("an error profile needs a name, got an empty one: results say which it was")
        for term in self.terms:
            if not (is_dataclass(term) and isinstance(term, ErrorTerm)) or isinstance(term, type):
                raise ValueError(f"terms must be error terms such as Calibration(), got {term!r}: see ErrorTerm")

    @property
    def digest(self) -> str:
        """SHA-256 of all terms and their numbers, whatever the profile is called."""
        return key_of([[type(term).__module__, type(term).__qualname__, _numbers(term)] for term in self.terms]).hex()

    @property
    def modules(self) -> list[str]:
        """Where the terms are defined."""
        return sorted({type(term).__module__ for term in self.terms})

    @property
    def needs_velocities(self) -> bool:
        """Whether some term has to know how fast the objects are."""
        return any(term.needs_velocities for term in self.terms)

    @property
    def origin(self) -> dict[str, str]:
        """What results say of it."""
        return {"profile": self.name, "digest": self.digest}

    def read(self, truth: TrueImage, *, seed: int, sensor: int, frame: int) -> Reading:
        """What a sensor says of what it looks at.

        seed: of the recording's errors; sensor: a number that stands for the sensor; frame: its number.
        """
        reading, before = Reading.of(truth), Counter[str]()
        for term in self.terms:
            kind = type(term).__qualname__
            stream = zlib.crc32(f"{kind} {before[kind]}".encode())
            before[kind] += 1
            reading = term.apply(reading, Draws(seed, sensor, frame, stream))
        return reading


def _numbers(term: Any) -> dict[str, Any]:
    """The fields of a term as plain numbers and texts."""
    return {name: value.item() if isinstance(value, np.generic) else value for name, value in asdict(term).items()}


def check_least(term: Any, **least: int | float) -> None:
    """ValueError where a number of a term is none, not finite or below the least it may be."""
    for name, lowest in least.items():
        value = getattr(term, name)
        if not isinstance(value, int | float | np.number) or not lowest <= value < np.inf:
            raise ValueError(f"{name} of {type(term).__name__} must be a number from {lowest:g} on, got {value!r}")


def check_share(term: Any, *names: str) -> None:
    """ValueError where a number of a term is no share."""
    for name in names:
        value = getattr(term, name)
        if not isinstance(value, int | float | np.number) or not 0 <= value <= 1:
            raise ValueError(f"{name} of {type(term).__name__} must be a share from 0 to 1, got {value!r}")
