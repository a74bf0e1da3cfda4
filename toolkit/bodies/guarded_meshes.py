"""Meshes of kinds that Open3D may hang or crash on when they are damaged, read in a process of their own.

What Open3D does with a damaged glTF or FBX file is beyond our control: it was seen to run without end. A process of its
own, with a time limit, makes one error of it.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from toolkit.arrays import Float64, Int64

GUARDED = (".glb", ".gltf", ".fbx")
LIMIT_S = 120.0  # Open3D alone takes some seconds to load

_READ = """
import sys
import numpy as np
import open3d as o3d
with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
    mesh = o3d.io.read_triangle_mesh(sys.argv[1])
np.savez(sys.argv[2], vertices=np.asarray(mesh.vertices), triangles=np.asarray(mesh.triangles, np.int64))
"""


def read_guarded_mesh(
    path: Path, *, limit_s: float = LIMIT_S
) -> tuple[Float64[np.ndarray, "k 3"], Int64[np.ndarray, "m 3"]]:
    """Vertices and triangles of a mesh file, none where Open3D finds none. Raises ValueError, without the file's name,
    where reading it takes longer than the limit or ends the process."""
    with TemporaryDirectory() as folder:
        read = Path(folder) / "mesh.npz"
        command = [sys.executable, "-c", _READ, str(path), str(read)]
        try:
            subprocess.run(command, check=True, timeout=limit_s, stdin=subprocess.DEVNULL, capture_output=True)
        except subprocess.TimeoutExpired:
            raise ValueError(f"Open3D has not read it after {limit_s:g} s") from None
        except subprocess.CalledProcessError as error:
            raise ValueError(f"Open3D fails over it with exit status {error.returncode}") from None
        with np.load(read) as arrays:
            return arrays["vertices"].reshape(-1, 3), arrays["triangles"].reshape(-1, 3)
