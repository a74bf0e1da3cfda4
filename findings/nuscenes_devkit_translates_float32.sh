#!/bin/sh
# The nuScenes devkit moves clouds in float32: in UTM the points of a car fall on a handful of lines.
#
# nuscenes-devkit 1.2.0 (NumPy 1.26.4). LidarPointCloud keeps its points as float32, and translate() adds an ego pose in
# place. Its own rendering moves clouds from the sensor to the map and back that way, although ego poses are float64 in
# the tables. With a set whose map is UTM, 300 points between y = -0.9 and 0.9 m come back from 5336000 m with 5
# different y, up to 0.25 m off; at 1000 m, as in nuScenes itself, they stay within 0.1 mm. Nothing warns.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check nuscenes-devkit==1.2.0 numpy==1.26.4
"$folder/venv/bin/python" - <<'PYTHON'
import numpy as np
from nuscenes.utils.data_classes import LidarPointCloud


def move(translation):
    """How many y are left, and how far off, after the way to the map and back."""
    y = np.linspace(-0.9, 0.9, 300)
    cloud = LidarPointCloud(np.vstack([np.full(300, 10.0), y, np.zeros(300), np.ones(300)]).astype(np.float32))
    cloud.translate(np.array(translation))
    cloud.translate(-np.array(translation))
    left, off = len(np.unique(cloud.points[1])), float(np.abs(cloud.points[1] - y).max())
    print(translation, "different y:", left, "largest error:", round(off, 4), "m", cloud.points.dtype)
    return left, off


left, off = move([600.0, 1000.0, 0.0])
assert left > 290
assert off < 1e-4
left, off = move([692000.0, 5336000.0, 520.0])
assert left < 10
assert off > 0.2
PYTHON
