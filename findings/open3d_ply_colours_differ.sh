#!/bin/sh
# A PLY that Open3D's tensor writer makes of floating colours is nearly black for Open3D's usual reader.
#
# Open3D 0.20.0, trimesh 5.2.0 (NumPy 2.4.6). open3d.t.io.write_point_cloud writes colours (1, 0, 0.2) of float32 as
# "property float red" and so on, in the range 0 to 1. open3d.io.read_point_cloud then takes the floats for bytes and
# divides them by 255: (0.0039, 0, 0.0008). Its tensor reader and trimesh give (1, 0, 0.2) and (255, 0, 51).
# The same colours as bytes ("property uchar red") are right in all three.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check open3d==0.20.0 numpy==2.4.6 trimesh==5.2.0
cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
import open3d as o3d
import trimesh


def write(colours, name):
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor.from_numpy(np.zeros((3, 3), np.float32)))
    cloud.point.colors = o3d.core.Tensor.from_numpy(np.tile(colours, (3, 1)))
    o3d.t.io.write_point_cloud(name, cloud)


def read(name):
    usual = np.asarray(o3d.io.read_point_cloud(name).colors)[0]
    tensor = o3d.t.io.read_point_cloud(name).point.colors.numpy()[0]
    other = np.asarray(trimesh.load(name).colors)[0, :3]
    print(name, "usual reader", usual.round(4), "tensor reader", tensor, "trimesh", other)
    return usual, tensor, other


write(np.array([[1.0, 0.0, 0.2]], np.float32), "floats.ply")
usual, tensor, other = read("floats.ply")
assert np.allclose(usual, np.array([1.0, 0.0, 0.2]) / 255, atol=1e-4)
assert np.allclose(tensor, [1.0, 0.0, 0.2])
assert other.tolist() == [255, 0, 51]
write(np.array([[255, 0, 51]], np.uint8), "bytes.ply")
usual, tensor, other = read("bytes.ply")
assert np.allclose(usual, [1.0, 0.0, 0.2])
assert tensor.tolist() == other.tolist() == [255, 0, 51]
PYTHON
