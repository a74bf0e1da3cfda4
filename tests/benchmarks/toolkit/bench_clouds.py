"""Depth images of six 200×150 cameras to one cropped cloud: ours beside the plain Open3D script, in
one run.

python tests/benchmarks/toolkit/bench_clouds.py
"""

import numpy as np
import open3d as o3d
from timing import report

from toolkit.clouds import crop, from_depth, fuse
from toolkit.frame import Frame
from toolkit.geometry import look
from toolkit.objects import Objects
from toolkit.points import frame_points
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor

BENCH = "toolkit/bench_clouds.py"
AREA = np.array([-40.0, -20.0, 40.0, 20.0])
POSTS = [
    (40.9, 8.1, 155),
    (-7.7, 21.9, 295),
    (-45.6, 10.1, 15),
    (8.0, 5.6, 52),
    (-8.3, 18.5, 208),
    (-5.5, -27.5, 64),
]
SENSORS = tuple(
    Sensor(f"{k}", DepthCamera(), look((x, y, 5.2), np.deg2rad(heading), tilt=np.deg2rad(6.0)))
    for k, (x, y, heading) in enumerate(POSTS)
)


def street(sensor: Sensor, rng: np.random.Generator) -> np.ndarray:
    """Depth of uneven ground as far as 70 m, and of walls at 30 to 60 m in half of what looks above
    the horizon."""
    falling = sensor.world_rays[2].reshape(sensor.model.shape)
    ground = np.where(
        falling < -0.01,
        (rng.normal(0.0, 0.02, falling.shape) - 5.2) / np.minimum(falling, -0.01),
        0.0,
    )
    wall = np.where(rng.random(falling.shape) < 0.5, rng.uniform(30, 60, falling.shape), 0.0)
    return np.where((ground > 0) & (ground < 70), ground, wall).astype(np.float32)


def plain_open3d(frame: Frame) -> o3d.geometry.PointCloud:
    """What one would write with Open3D's legacy clouds: one per camera, transform, +, crop."""
    intrinsic = o3d.camera.PinholeCameraIntrinsic(200, 150, 100.0, 100.0, 100.0, 75.0)
    fused = o3d.geometry.PointCloud()
    for sensor, depth in zip(frame.sensors, frame.measurements, strict=True):
        image = o3d.geometry.Image(depth)
        cloud = o3d.geometry.PointCloud.create_from_depth_image(
            image, intrinsic, depth_scale=1.0, depth_trunc=1000.0
        )
        fused += cloud.transform(sensor.pose)
    return fused.crop(o3d.geometry.AxisAlignedBoundingBox([*AREA[:2], 0.0], [*AREA[2:], 4.0]))


def main() -> None:
    rng = np.random.default_rng(0)
    frame = Frame(SENSORS, tuple(street(sensor, rng) for sensor in SENSORS), Objects.empty())
    images = list(zip(frame.sensors, frame.measurements, strict=True))
    plain = report(
        "plain Open3D script",
        lambda: plain_open3d(frame),
        row=("the same as a plain Open3D script", BENCH),
    )
    points = report(
        "frame_points",
        lambda: np.concatenate(frame_points(frame, area=AREA)),
        limit_ms=5.0,
        row=("depth → world → crop → fuse, six 200 × 150 sensors", BENCH),
    )
    steps = report(
        "from_depth, crop, fuse",
        lambda: fuse(
            crop(from_depth(sensor, depth, sensor_id=k), AREA)
            for k, (sensor, depth) in enumerate(images)
        ),
    )
    times = ", ".join(f"{plain / ms:.1f}" for ms in (points, steps))
    print(f"times as fast as the plain script, at least 3 wanted: {times}")


if __name__ == "__main__":
    main()
