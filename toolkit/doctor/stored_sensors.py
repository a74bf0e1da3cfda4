"""Mistakes in a sensor's stored pose or depth."""

from collections.abc import Sequence

import numpy as np

from toolkit.arrays import Pose
from toolkit.datasets import published_layout as published
from toolkit.doctor.moving_points import Rows, Witness, share_on_boxes
from toolkit.doctor.suspicions import MIN_CLEAR_GAIN, MIN_EXPLAINED_FIT, Suspicion
from toolkit.geometry import invert, transform
from toolkit.sensors.sensor import Sensor

# axes x right, y down, z forward
_FORWARD_FIRST = np.array([[0.0, 0, 1, 0], [1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
_FOR_ANOTHER = "its extrinsic is for a right-handed world and a camera with"
# remedy by mistake, in the order in which `suspect_sensor` tries them
_SENSOR_MISTAKES = {
    "its extrinsic is camera → world, the inverse of what belongs there": (
        "store the inverse of extrinsic"
    ),
    f"{_FOR_ANOTHER} x right, y down, z forward": (
        "turn extrinsic into CARLA's world (y negated) and a camera with X forward, Y right, Z up"
    ),
    f"{_FOR_ANOTHER} x forward, y left, z up": (
        "negate y of the world and of the camera in extrinsic"
    ),
    "its depth is the distance along the ray, not along the optical axis": (
        "divide each depth by the length of its ray whose X is 1"
    ),
    "it looks away: in the opposite direction": (
        "turn extrinsic by 180 degrees about the camera's Z"
    ),
}


def suspect_sensor(
    witnesses: Sequence[Witness], sensor: Sensor, rows: Sequence[Rows], map_SE3_site: Pose
) -> tuple[Suspicion | None, float]:
    """Find the mistake in one sensor's pose or depth whose undoing raises its fit most.

    Args:
        witnesses: moving pixels of the sensor in all frames.
        sensor: the sensor at its stored pose.
        rows: published rows of the objects of each frame.
        map_SE3_site: pose of the site in the map.

    Returns the suspected mistake, None without a clear one, and the share of its moving points on
    boxes as stored, 0 to 1."""
    stored_extrinsic = published.extrinsic(sensor.pose, map_SE3_site)

    def measure_fit(matrix: np.ndarray, along_ray: bool = False) -> float:
        """Share of the moving points on boxes, 0 to 1, for a pose of the sensor.

        matrix: the pose as a published extrinsic; along_ray: True if depth is the distance along
        the ray."""
        pose = published.parse_extrinsic(matrix, map_SE3_site)
        clouds = []
        for witness in witnesses:
            rays = witness.rays
            if along_ray:
                rays = rays / np.linalg.norm(rays, axis=1, keepdims=True)
            clouds.append(transform(pose, rays * witness.depth[:, None]))
        return share_on_boxes(
            clouds, [rows[witness.frame_index] for witness in witnesses], map_SE3_site
        )

    current_fit = measure_fit(stored_extrinsic)
    if current_fit > 1 - MIN_CLEAR_GAIN:
        return None, current_fit
    mirror_y = published.MAP_FROM_CARLA  # (4, 4), between left-handed and right-handed axes
    fits_without_mistake = (  # in the order of _SENSOR_MISTAKES
        measure_fit(invert(stored_extrinsic)),
        measure_fit(_FORWARD_FIRST @ stored_extrinsic @ mirror_y),
        measure_fit(mirror_y @ stored_extrinsic @ mirror_y),
        measure_fit(stored_extrinsic, along_ray=True),
        measure_fit(np.diag([-1.0, -1, 1, 1]) @ stored_extrinsic),  # turned about z by 180 degrees
    )
    pairs = zip(_SENSOR_MISTAKES.items(), fits_without_mistake, strict=True)
    attempts = [
        Suspicion(mistake=mistake, remedy=remedy, fit_before=current_fit, fit_after=after)
        for (mistake, remedy), after in pairs
    ]
    best = max(attempts, key=lambda suspicion: suspicion.fit_after)
    is_clear = best.fit_after >= max(MIN_EXPLAINED_FIT, current_fit + MIN_CLEAR_GAIN)
    return best if is_clear else None, current_fit
