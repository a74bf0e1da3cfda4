"""`code_digest`: what is kept on disk is believed only while the code that computed it is the same."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

RENDERING = (
    *("toolkit/boxes.py", "toolkit/mesh.py", "toolkit/points.py", "toolkit/render.py", "toolkit/scenery.py"),
    *("toolkit/sensors.py", "models/packed.py", "models/packing.py", "placement_env/renders.py"),
    *("placement_env/silhouettes.py", "placement_env/sightings.py", "placement_env/visibility.py"),
)
DETECTION = (
    *("toolkit/cluster.py", "toolkit/fusion.py", "toolkit/metrics.py", "toolkit/objects.py", "models/anchors.py"),
    *("models/detector.py", "models/folding.py", "models/published.py", "models/sparse.py", "models/sparse_middle.py"),
    *("models/sparse_columns.py", "models/voxelnet.py", "models/voxels.py", "placement_env/detection.py"),
)


@cache
def code_digest(*files: str) -> str:
    """SHA-256 over source files of this checkout or installation, named from its top."""
    root, digest = Path(__file__).parents[1], hashlib.sha256()
    for name in files:
        digest.update(name.encode() + (root / name).read_bytes())
    return digest.hexdigest()
