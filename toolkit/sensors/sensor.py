"""`Sensor`: a sensor model at a place."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from functools import cached_property
from hashlib import sha256

import numpy as np

from toolkit.arrays import Float32, Float64
from toolkit.geometry import check_pose, invert
from toolkit.sensors.model import SensorModel, frozen


@dataclass(frozen=True, eq=False)
class Sensor:
    """A sensor model at a place: `pose` is world_SE3_sensor. Raises ValueError where the pose is no rigid motion.

    The world is a site's own frame, metres from an origin near by: points are float32, good to 1 mm within 10 km of it.
    """

    name: str
    model: SensorModel
    pose: Float64[np.ndarray, "4 4"] = field(repr=False)

    def __post_init__(self) -> None:
        pose = check_pose(self.pose, f"pose of sensor {self.name!r}").copy()
        pose.setflags(write=False)
        object.__setattr__(self, "pose", pose)

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Sensor)
            and (self.name, self.model) == (other.name, other.model)
            and np.array_equal(self.pose, other.pose)
        )

    def __hash__(self) -> int:
        return hash((self.name, self.model))

    @property
    def position(self) -> Float64[np.ndarray, "3"]:
        """Where it is, world frame (m)."""
        return self.pose[:3, 3]

    @property
    def world_SE3_body(self) -> Float64[np.ndarray, "4 4"]:
        """The pose of its body: x along the optical axis, y left, z up, whatever the axes of its own frame."""
        return self.pose @ invert(self.model.body_SE3_sensor)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of model and pose, whatever the sensor is called: equal where two measure the same."""
        described = json.dumps(
            [type(self.model).__name__, asdict(self.model), self.pose.tolist()],
            sort_keys=True,
            default=np.ndarray.tolist,
        )
        return sha256(described.encode()).hexdigest()

    @cached_property
    def world_rays(self) -> Float32[np.ndarray, "3 pixels"]:
        """x, y and z of each pixel's ray in the world's axes, row after row of the image (paper equation 1)."""
        rays = self.model.rays().reshape(-1, 3).astype(np.float64)
        return frozen(np.ascontiguousarray(self.pose[:3, :3] @ rays.T))
