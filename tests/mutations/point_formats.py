"""Sound files of points, poses and meshes, and what reads them."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import open3d as o3d
import pyarrow
import trimesh

from toolkit.clouds import from_points, save
from toolkit.datasets.cloud_files import fuse_files
from toolkit.geometry import pose


def points() -> np.ndarray:
    return np.random.default_rng(0).uniform(-50, 50, (200, 3)).astype(np.float32)


def cloud() -> Any:
    cloud = from_points(points(), np.arange(200) % 3)
    cloud.point["intensity"] = o3d.core.Tensor.from_numpy(
        np.linspace(0, 1, 200, dtype=np.float32)[:, None].copy()
    )
    return cloud


def ply(path: Path) -> None:
    o3d.t.io.write_point_cloud(path, cloud())


def ply_text(path: Path) -> None:
    o3d.t.io.write_point_cloud(path, cloud(), write_ascii=True)


def las(path: Path) -> None:
    """LAS 1.2 with colours and times, packed as LAZ by the file's ending."""
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales, header.offsets = np.full(3, 0.001), np.array([1000.0, 2000.0, 0.0])
    scan = laspy.LasData(header)
    scan.x, scan.y, scan.z = points().T + header.offsets[:, None]
    scan.intensity = np.arange(200)
    scan.gps_time = np.linspace(0, 1, 200)
    scan.red = np.arange(200) * 256
    scan.write(path)


def open3d_pcd(path: Path) -> None:
    save(cloud(), path)


def pcd(kind: str) -> Callable[[Path], None]:
    """As PCL and ROS write it, with padding between the fields."""

    def make(path: Path) -> None:
        dtype = [
            ("x", "<f4"),
            ("y", "<f4"),
            ("z", "<f4"),
            ("p", "u1", 4),
            ("intensity", "<f4"),
            ("q", "u1", 12),
        ]
        rows = np.zeros(200, dtype)
        for axis, column in zip("xyz", points().T, strict=True):
            rows[axis] = column
        header = (
            "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z _ intensity _\nSIZE 4 4 4 1 4 1\nTYPE F F F "
            "U F U\nCOUNT 1 1 1 4 1 12\nWIDTH 200\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS "
            f"200\nDATA {kind}\n"
        ).encode()
        if kind == "ascii":
            body = "\n".join(
                " ".join(str(v) for v in np.hstack([*row])) for row in rows.tolist()
            ).encode()
        elif kind == "binary":
            body = rows.tobytes()
        else:
            columns = b"".join(rows[name].tobytes() for name in rows.dtype.names or ())
            packed = b"".join(
                bytes([len(columns[k : k + 32]) - 1]) + columns[k : k + 32]
                for k in range(0, len(columns), 32)
            )
            body = np.array([len(packed), len(columns)], "<u4").tobytes() + packed
        path.write_bytes(header + body)

    return make


def xyz(path: Path) -> None:
    np.savetxt(path, points()[:60], header="x y z", fmt="%.4f")


def csv(path: Path) -> None:
    np.savetxt(path, points()[:60], header="x,y,z", comments="", delimiter=",", fmt="%.4f")


def npy(path: Path) -> None:
    np.save(path, points())


def bin(path: Path) -> None:
    np.hstack([points(), np.ones((200, 1), np.float32)]).tofile(path)


def feather(path: Path) -> None:
    from pyarrow import feather

    columns = dict(zip("xyz", points().T, strict=True)) | {
        "laser_number": np.arange(200, dtype=np.uint8)
    }
    feather.write_feather(pyarrow.table(columns), path)


def read_cloud(path: Path) -> None:
    """Read points, which must be numbers."""
    fused = fuse_files([path], [np.eye(4)]).point.positions.numpy()
    if not np.isfinite(fused).all():
        raise RuntimeError("points of no numbers were read")


def two_poses() -> dict[str, Any]:
    return {
        "north": pose(1.0, 2.0, 5.0, yaw=1.0).tolist(),
        "south": pose(4.0, 2.0, 5.0, yaw=-1.0)[:3].tolist(),
    }


def poses_json(path: Path) -> None:
    path.write_text(json.dumps(two_poses()))


def poses_text(path: Path) -> None:
    path.write_text(
        "\n".join(f"{name} {' '.join(map(str, np.ravel(p)))}" for name, p in two_poses().items())
    )


def read_poses(path: Path) -> None:
    from toolkit.datasets.pose_files import load_poses, match_poses, read_poses

    read_poses(path, inverted=True)
    match_poses(["north.ply", "south.ply"], read_poses(path))
    load_poses(["north.ply", "south.ply"], [path])


def mesh(path: Path) -> None:
    trimesh.creation.box((4.4, 1.8, 1.5)).export(path)


def text_mesh(path: Path) -> None:
    """glTF in JSON, its buffer within it."""
    files = trimesh.creation.box((4.4, 1.8, 1.5)).export(file_type="gltf", embed_buffers=True)
    path.write_bytes(files["model.gltf"])
