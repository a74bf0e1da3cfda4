"""ASAM OSI 3.8 in MCAP: a GroundTruth of moving objects per instant, topic ground_truth.

- `base.position` is the centre of the box, `orientation.yaw` lies in -pi..pi, velocities are in the
  world frame; an unknown velocity stays unset.
- A vehicle is a CAR, heavy is a HEAVY_TRUCK, a cyclist a BICYCLE with its rider's box, and each has
  the role CIVIL.
- GroundTruth has no score: it is an identifier of the object's `source_reference`, as
  `score=0.87`.
- betterosi adds the file's metadata (versions, time of writing) and fills in nothing else."""

from pathlib import Path
from typing import Any

import numpy as np

from toolkit.datasets.problem_kinds import Problems
from toolkit.exchange.instant import Instant
from toolkit.exchange.writer import nanoseconds
from toolkit.objects import LABELS

OSI_VERSION = (3, 8, 0)
OSI_TOPIC = "ground_truth"
SCORE_KEY = "score"
_SOURCE = "net.coview"
_VEHICLE_TYPES = {"vehicle": "CAR", "cyclist": "BICYCLE", "heavy": "HEAVY_TRUCK"}
_NS_PER_S = 10**9


class OsiWriter:
    """Writer of one MCAP file of OSI."""

    def __init__(self, path: Path) -> None:
        """Open an MCAP file to write an instant's objects as OSI's ground truth."""
        import betterosi

        self.problems: Problems = {}
        self._osi = betterosi
        version = ".".join(map(str, OSI_VERSION))
        self._writer = betterosi.Writer(
            str(path), topic=OSI_TOPIC, version=version, library="coview"
        )

    def write(self, instant: Instant) -> None:
        """Write the message of an instant."""
        osi = self._osi
        time_ns = nanoseconds(instant.time_s)
        message = osi.GroundTruth(
            version=osi.InterfaceVersion(
                version_major=OSI_VERSION[0],
                version_minor=OSI_VERSION[1],
                version_patch=OSI_VERSION[2],
            ),
            timestamp=osi.Timestamp(seconds=time_ns // _NS_PER_S, nanos=time_ns % _NS_PER_S),
            moving_object=self._moving_objects(instant),
        )
        self._writer.add(message, log_time=time_ns)

    def close(self) -> None:
        """Complete the file."""
        self._writer.__exit__(None, None, None)

    def _moving_objects(self, instant: Instant) -> list[Any]:
        """Return each row of an instant as message MovingObject."""
        velocities = instant.known_velocities()
        objects = []
        for row, track_id in enumerate(instant.list_ids()):
            label = LABELS[instant.labels[row]]
            base = self._base_moving(instant.boxes[row], velocities[row])
            score = float(instant.scores[row])
            objects.append(self._moving_object(track_id, label=label, base=base, score=score))
        return objects

    def _moving_object(self, track_id: int, *, label: str, base: Any, score: float) -> Any:
        """Return a road user as message MovingObject, its score as a reference.

        label: a name of `LABELS`; base: message BaseMoving of its box."""
        osi = self._osi
        kinds = osi.MovingObject.Type
        reference = osi.ExternalReference(
            reference=_SOURCE, type=SCORE_KEY, identifier=[f"{SCORE_KEY}={score:.6g}"]
        )
        moving = osi.MovingObject(
            id=osi.Identifier(value=track_id),
            base=base,
            type=kinds.VEHICLE if label in _VEHICLE_TYPES else kinds.PEDESTRIAN,
            source_reference=[reference],
        )
        if label in _VEHICLE_TYPES:
            classes = osi.MovingObject.VehicleClassification
            moving.vehicle_classification = classes(
                type=classes.Type[_VEHICLE_TYPES[label]], role=classes.Role.CIVIL
            )
        return moving

    def _base_moving(self, box: np.ndarray, velocity: tuple[float, float, float] | None) -> Any:
        """Return message BaseMoving of a box (x y z length width height yaw).

        velocity: along x, y and z of the world frame (m/s), None if unknown."""
        osi = self._osi
        x, y, z = box[:3].tolist()
        length, width = box[3:5].tolist()
        yaw = float(np.arctan2(np.sin(box[6]), np.cos(box[6])))  # in -pi..pi
        base = osi.BaseMoving(
            dimension=osi.Dimension3d(length=length, width=width, height=float(box[5])),
            position=osi.Vector3d(x=x, y=y, z=z),
            orientation=osi.Orientation3d(roll=0.0, pitch=0.0, yaw=yaw),
        )
        if velocity is not None:
            base.velocity = osi.Vector3d(x=velocity[0], y=velocity[1], z=velocity[2])
        return base
