"""Cast rays as another processor would.

`PYTHONPATH=tests/jittered_rays pytest` moves every ray by about one unit in the last place, as
another instruction set does, in child processes too: rays at an edge then hit what lies beside it.
The suite passes with and without.
"""

import os
import sys
from importlib.abc import Loader, MetaPathFinder
from importlib.util import find_spec

SHARE = float(os.environ.get("TEST_RAY_JITTER", 1e-7))


def jitter(cast):
    """Perturb rays by a fixed function of themselves, so that equal rays stay equal."""
    import numpy as np
    import open3d as o3d

    def cast_jittered(scene, rays, *args, **options):
        lines = np.array(rays.numpy() if hasattr(rays, "numpy") else rays, np.float32)
        phase = lines.astype(np.float64) @ np.array([311.7, 127.1, 269.5, 1833.3, 2461.9, 1139.1])
        lines[..., 3:] *= 1 + SHARE * np.sin(phase[..., None] + np.arange(3))
        return cast(scene, o3d.core.Tensor(lines), *args, **options)

    return cast_jittered


class JitterOpen3D(MetaPathFinder, Loader):
    """Loads Open3D as usual, then replaces the functions that cast rays."""

    def find_spec(self, name, path=None, target=None):
        if name != "open3d":
            return None
        sys.meta_path.remove(self)
        spec = find_spec(name)
        self.loader, spec.loader = spec.loader, self
        return spec

    def create_module(self, spec):
        return self.loader.create_module(spec)

    def exec_module(self, module):
        self.loader.exec_module(module)
        scene = module.t.geometry.RaycastingScene
        for name in ("cast_rays", "test_occlusions"):
            setattr(scene, name, jitter(getattr(scene, name)))


sys.meta_path.insert(0, JitterOpen3D())
