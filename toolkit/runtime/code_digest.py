"""`code_digest`: what is kept on disk is believed only while the code that computed it is the same."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

RENDERING = (
    *("toolkit/boxes.py", "toolkit/mesh.py", "toolkit/points.py", "toolkit/rendering/renderer.py"),
    *("toolkit/rendering/static_scene.py", "toolkit/rendering/silhouettes.py", "toolkit/sensors/sensor.py"),
    *("models/packed.py", "models/packing.py", "placement_env/fidelity/renders.py"),
    *("placement_env/fidelity/occlusion.py", "placement_env/fidelity/visibility.py"),
)
DETECTION = (
    *("toolkit/detection/cluster.py", "toolkit/detection/fusion.py", "toolkit/detection/metrics.py"),
    *("toolkit/detection/view.py", "toolkit/detection/scheme.py", "toolkit/detection/codec.py"),
    *("toolkit/detection/early.py", "toolkit/detection/late.py", "toolkit/detection/hybrid.py"),
    *("toolkit/objects.py", "models/anchors.py", "models/detector.py", "models/folding.py", "models/published.py"),
    *("models/sparse.py", "models/sparse_middle.py", "models/sparse_columns.py", "models/voxelnet.py"),
    *("models/voxels.py", "placement_env/fidelity/detector.py"),
)


@cache
def code_digest(*files: str) -> str:
    """SHA-256 over source files of this checkout or installation, named from its top."""
    root, digest = Path(__file__).parents[2], hashlib.sha256()
    for name in files:
        digest.update(name.encode() + (root / name).read_bytes())
    return digest.hexdigest()
