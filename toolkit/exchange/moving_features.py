"""OGC Moving Features JSON (19-045r3): one feature per id, for GIS.

- A feature is a MovingPoint of longitude, latitude (CRS84) at times of ISO 8601, UTC to the
  microsecond. Degrees have ten decimals, less than 0.1 mm.
- Its temporal properties are z, length, width and height (m), bearing (degrees, clockwise from true
  north), score, and speed (m/s) at the times that know it. z is the height of the box's centre
  above the world's origin.
- Ground coordinates of the world frame become degrees by `toolkit.exchange.geo_origin`.
- The format has features, not frames: the file is written at the end, and an instant without
  objects leaves no mark."""

import json
from collections import Counter
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from toolkit.datasets.problem_kinds import Problems
from toolkit.exchange.geo_origin import GeoOrigin
from toolkit.exchange.instant import Instant
from toolkit.exchange.writer import nanoseconds
from toolkit.objects import LABELS

CRS84 = "urn:ogc:def:crs:OGC:1.3:CRS84"
ISO_TIMES = "urn:ogc:data:time:iso8601"
_DEGREE_DECIMALS = 10
_METRE_DECIMALS = 4
_UNITS = {  # UN/CEFACT codes
    "z": "MTR",
    "length": "MTR",
    "width": "MTR",
    "height": "MTR",
    "bearing": "DD",
    "score": "C62",
}


@dataclass
class _Mover:
    """Instants of one id.

    labels: number of instants by class; datetimes: of each instant; coordinates: longitude and
    latitude; values: of each property; speeds: datetime and m/s of the instants that know it."""

    labels: Counter[int] = field(default_factory=Counter)
    datetimes: list[str] = field(default_factory=list)
    coordinates: list[list[float]] = field(default_factory=list)
    values: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in _UNITS})
    speeds: list[tuple[str, float]] = field(default_factory=list)

    def describe(self, track_id: int) -> dict[str, Any]:
        """Return the road user's feature, of the class that it had most often."""
        interpolation = "Linear" if len(self.datetimes) > 1 else "Discrete"
        box_properties: dict[str, Any] = {"datetimes": self.datetimes}
        for name, unit in _UNITS.items():
            kind = "Step" if name == "bearing" else interpolation  # 359 to 1 is no turn of 358
            box_properties[name] = _measure(unit, self.values[name], kind)
        properties = [box_properties]
        if self.speeds:
            # velocities may be unknown at some moments, so each speed comes with its moment
            speeds_m_s = [speed for _, speed in self.speeds]
            interpolation_of_speed = "Linear" if len(speeds_m_s) > 1 else "Discrete"
            properties.append(
                {
                    "datetimes": [moment for moment, _ in self.speeds],
                    "speed": _measure("MTS", speeds_m_s, interpolation_of_speed),
                }
            )
        # class number, and how often
        ((label, _),) = self.labels.most_common(1)
        return {
            "type": "Feature",
            "id": str(track_id),
            "properties": {"id": track_id, "label": LABELS[label]},
            "temporalGeometry": {
                "type": "MovingPoint",
                "datetimes": self.datetimes,
                "coordinates": self.coordinates,
                "interpolation": interpolation,
            },
            "temporalProperties": properties,
        }


class MovingFeaturesWriter:
    """Writer of one collection of moving features."""

    def __init__(self, path: Path, origin: GeoOrigin) -> None:
        self.problems: Problems = {}
        self._path = path
        self._origin = origin
        self._movers: dict[int, _Mover] = {}

    def write(self, instant: Instant) -> None:
        """Add the objects of an instant to the features of their tracks."""
        moment = format_moment(instant.time_s)
        boxes = instant.boxes
        longitudes_latitudes = np.round(
            self._origin.degrees(boxes[:, :3]), _DEGREE_DECIMALS
        ).tolist()
        columns = {
            "z": boxes[:, 2],
            "length": boxes[:, 3],
            "width": boxes[:, 4],
            "height": boxes[:, 5],
            "bearing": self._origin.bearings_deg(boxes[:, 6]),
            "score": instant.scores,
        }
        rounded = {
            name: np.round(column, _METRE_DECIMALS).tolist() for name, column in columns.items()
        }
        # a bearing just below 360 is rounded to it
        rounded["bearing"] = [bearing % 360.0 for bearing in rounded["bearing"]]
        velocities = instant.known_velocities()
        for row, track_id in enumerate(instant.list_ids()):
            mover = self._movers.setdefault(track_id, _Mover())
            mover.labels[int(instant.labels[row])] += 1
            mover.datetimes.append(moment)
            mover.coordinates.append(longitudes_latitudes[row])
            for name, values in mover.values.items():
                values.append(rounded[name][row])
            velocity = velocities[row]
            if velocity is not None:
                speed = float(np.hypot(velocity[0], velocity[1]))
                mover.speeds.append((moment, round(speed, _METRE_DECIMALS)))

    def close(self) -> None:
        """Write the file."""
        head = {
            "type": "FeatureCollection",
            "crs": {"type": "Name", "properties": {"name": CRS84}},
            "trs": {"type": "Name", "properties": {"name": ISO_TIMES}},
        }
        with self._path.open("w", encoding="utf-8", newline="\n") as file:
            file.write(json.dumps(head).removesuffix("}") + ', "features": [')
            separator = "\n"
            for track_id, mover in self._movers.items():
                file.write(separator + json.dumps(mover.describe(track_id), allow_nan=False))
                separator = ",\n"
            file.write("\n]}\n")


def format_moment(time_s: float) -> str:
    """Return seconds since 1970 as a time of ISO 8601 in UTC, to the microsecond.

    >>> format_moment(1700000000.25)
    '2023-11-14T22:13:20.250000Z'
    """
    epoch = datetime(1970, 1, 1, tzinfo=UTC)
    moment = epoch + timedelta(microseconds=nanoseconds(time_s) // 1000)
    return f"{moment:%Y-%m-%dT%H:%M:%S.%f}Z"


def _measure(unit: str, values: list[float], interpolation: str) -> dict[str, Any]:
    """Return a temporal property of numbers.

    unit: code of UN/CEFACT; interpolation: Linear, Step or Discrete."""
    return {"type": "Measure", "form": unit, "values": values, "interpolation": interpolation}
