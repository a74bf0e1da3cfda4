#!/bin/sh
# Open3D's tensor voxel_down_sample averages every attribute in float32, whatever the attribute's type is.
#
# Open3D 0.20.0 (NumPy 2.4.6). A cloud in UTM coordinates (float64) with Unix times (float64), nanosecond stamps
# (int64) and sensor numbers (int32), two points in one voxel of 1 m:
# - the mean of times 1700000000.04 and 1700000000.06 comes out as 1700000000.0;
# - two equal stamps of 1700000000123456789 ns come out seconds away from themselves;
# - sensor numbers 1 and 2 come out as 1, a truncated mean that names a sensor which saw half of it;
# - a northing of 5336000.2, both points alike, comes out at another place, two decimetres away.
# The result has the types of the input, so nothing shows the loss. One would expect means in the type of the column.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check open3d==0.20.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
import open3d as o3d

tensor = o3d.core.Tensor.from_numpy
cloud = o3d.t.geometry.PointCloud()
cloud.point.positions = tensor(np.array([[692000.3, 5336000.2, 520.0]] * 2))
cloud.point["time"] = tensor(np.array([[1_700_000_000.04], [1_700_000_000.06]]))
cloud.point["stamp_ns"] = tensor(np.full((2, 1), 1_700_000_000_123_456_789, np.int64))
cloud.point["sensor"] = tensor(np.array([[1], [2]], np.int32))
down = cloud.voxel_down_sample(1.0)
time = down.point["time"].numpy()
stamp = down.point["stamp_ns"].numpy()
sensor = down.point["sensor"].numpy()
northing = down.point.positions.numpy()[0, 1]
print("points:", len(time), "types:", time.dtype, stamp.dtype, sensor.dtype)
print("time:", float(time[0, 0]), "sensor:", int(sensor[0, 0]))
print("stamp off by", int(stamp[0, 0]) - 1_700_000_000_123_456_789, "ns; northing off by", northing - 5336000.2, "m")
assert len(time) == 1
assert (time.dtype, stamp.dtype, sensor.dtype) == (np.float64, np.int64, np.int32)
assert time[0, 0] == 1_700_000_000.0
assert abs(int(stamp[0, 0]) - 1_700_000_000_123_456_789) > 1_000_000_000
assert sensor[0, 0] == 1
assert abs(northing - 5336000.2) > 0.01
PYTHON
