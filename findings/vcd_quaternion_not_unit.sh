#!/bin/sh
# vcd takes quaternions of OpenLABEL as they are: one that is not of length 1 stretches and turns another way.
#
# vcd 6.0.3 (NumPy 2.4.6). ASAM OpenLABEL 1.0.0 writes rotations as quaternions x y z w "in non-unit form ... as in the
# SciPy convention", and its example of a cuboid has (1, 1, 1, 1), of length 2. SciPy divides by the length. A lidar at
# (20, 0, 5) that is turned by a quarter about z sees a point 10 m ahead, which is at (20, 10, 5) in the world:
# - pose_wrt_parent with (0, 0, 0.7071068, 0.7071068): vcd's Scene gives (20, 10, 5);
# - with (0, 0, 1, 1), the same rotation: (10, 20, 5);
# - with (0, 0, 2, 2), the same again: (-50, 80, 5).
# All three files pass vcd's validation by the schema, and nothing warns.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check vcd==6.0.3 numpy==2.4.6 scipy==1.17.1
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
from scipy.spatial.transform import Rotation
from vcd import core, scl


def see(quaternion):
    """Place in the world of a point 10 m ahead of the lidar, by vcd and by SciPy."""
    pose = {"quaternion": quaternion, "translation": [20.0, 0.0, 5.0]}
    systems = {
        "world": {"type": "scene_cs", "parent": "", "children": ["lidar"]},
        "lidar": {"type": "sensor_cs", "parent": "world", "children": [], "pose_wrt_parent": pose},
    }
    content = core.OpenLABEL()
    document = {"metadata": {"schema_version": "1.0.0"}, "coordinate_systems": systems}
    content.load_from_json({"openlabel": document}, True)
    matrix, _ = scl.Scene(content).get_transform("lidar", "world")
    by_scipy = Rotation.from_quat(quaternion).apply([10.0, 0.0, 0.0]) + pose["translation"]
    print(quaternion, "vcd", (matrix @ [10, 0, 0, 1])[:3].round(3), "SciPy", by_scipy.round(3))
    assert np.allclose(by_scipy, [20, 10, 5])
    return (matrix @ [10, 0, 0, 1])[:3]


half = float(np.sqrt(0.5))
assert np.allclose(see([0.0, 0.0, half, half]), [20, 10, 5])
assert np.allclose(see([0.0, 0.0, 1.0, 1.0]), [10, 20, 5])
assert np.allclose(see([0.0, 0.0, 2.0, 2.0]), [-50, 80, 5])
PYTHON
