"""Clouds that coview writes, read back by the packages their users use, values compared.

Open3D's legacy reader gives zeros for 8-byte x, y and z of a PCD file (0.20.0), so PCD holds
float32 from an origin that its header states; trimesh and Open3D take floating colours of a PLY for
shares of 255, so colours are bytes."""

import json
import re
import warnings
from typing import Any

import numpy as np
import open3d as o3d
import pytest
import trimesh

from coview.main import run
from toolkit.clouds import attributes, from_attributes, load, save

COUNT = 200
UTM = np.array([692000.0, 5336000.0, 520.0])
RNG = np.random.default_rng(5)
NEAR = RNG.uniform(-40, 40, (COUNT, 3))
INTEGERS = ("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "bool")


def some_cloud(points):
    columns = {
        "positions": points,
        "normals": np.tile([0.0, 0.6, 0.8], (COUNT, 1)).astype(points.dtype),
        "colors": np.tile([255, 0, 51], (COUNT, 1)).astype(np.uint8),
        "intensity": np.linspace(0, 1, COUNT, dtype=np.float32)[:, None],
        "time": 1.7e9 + np.linspace(0, 0.1, COUNT)[:, None],
    }
    for kind in INTEGERS:
        columns[f"a_{kind}"] = (np.arange(COUNT) % 2).astype(kind)[:, None]
    return from_attributes(columns, 3)


def stated_origin(path):
    header = path.read_bytes().split(b"\nDATA")[0].decode()
    line = re.search(r"# coview origin: (\S+) (\S+) (\S+)", header)
    return np.zeros(3) if line is None else np.array([float(number) for number in line.groups()])


@pytest.mark.parametrize(
    "places", [NEAR.astype(np.float32), NEAR, NEAR + UTM], ids=["float32", "float64", "utm"]
)
def test_pcd(tmp_path, places):
    path = tmp_path / "a.pcd"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        save(some_cloud(places), path)
    origin = stated_origin(path)
    legacy = o3d.io.read_point_cloud(str(path))
    tensor = o3d.t.io.read_point_cloud(str(path))
    for points in (np.asarray(legacy.points), tensor.point.positions.numpy()):
        np.testing.assert_allclose(points + origin, places, atol=2e-4 if origin.any() else 5e-6)
    np.testing.assert_allclose(
        np.asarray(legacy.normals), np.tile([0, 0.6, 0.8], (COUNT, 1)), atol=1e-6
    )
    np.testing.assert_allclose(
        np.asarray(legacy.colors) * 255, np.tile([255, 0, 51], (COUNT, 1)), atol=0.5
    )
    np.testing.assert_allclose(
        tensor.point["intensity"].numpy()[:, 0], np.linspace(0, 1, COUNT), atol=1e-6
    )
    np.testing.assert_allclose(
        tensor.point["time"].numpy()[:, 0], 1.7e9 + np.linspace(0, 0.1, COUNT), atol=1e-6
    )
    ours = attributes(load(path))
    np.testing.assert_allclose(ours["positions"], places, atol=2e-4)
    for kind in INTEGERS:
        np.testing.assert_array_equal(ours[f"a_{kind}"][:, 0], np.arange(COUNT) % 2)


@pytest.mark.parametrize(
    "places", [NEAR.astype(np.float32), NEAR, NEAR + UTM], ids=["float32", "float64", "utm"]
)
def test_ply(tmp_path, places):
    path = tmp_path / "a.ply"
    save(some_cloud(places), path)
    legacy = o3d.io.read_point_cloud(str(path))
    tensor = o3d.t.io.read_point_cloud(str(path))
    other: Any = trimesh.load(path)
    for points in (np.asarray(legacy.points), tensor.point.positions.numpy(), other.vertices):
        np.testing.assert_allclose(points, places, atol=1e-6)
    np.testing.assert_allclose(
        np.asarray(legacy.colors) * 255, np.tile([255, 0, 51], (COUNT, 1)), atol=0.5
    )
    np.testing.assert_array_equal(
        np.asarray(other.colors)[:, :3], np.tile([255, 0, 51], (COUNT, 1))
    )
    table = other.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(table["time"], 1.7e9 + np.linspace(0, 0.1, COUNT))
    for kind in INTEGERS:
        np.testing.assert_array_equal(table[f"a_{kind}"], np.arange(COUNT) % 2)
        np.testing.assert_array_equal(
            attributes(load(path))[f"a_{kind}"][:, 0], np.arange(COUNT) % 2
        )


def test_npz(tmp_path):
    cloud = some_cloud(NEAR + UTM)
    save(cloud, tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as arrays:
        for name, column in attributes(cloud).items():
            np.testing.assert_array_equal(arrays[name], column)
            assert arrays[name].dtype == column.dtype


def test_floating_colours_are_shares_of_full_intensity(tmp_path):
    shares = np.tile([1.0, 0.0, 0.2], (COUNT, 1)).astype(np.float32)
    cloud = from_attributes({"positions": NEAR, "colors": shares}, 0)
    for name in ("a.ply", "a.pcd"):
        save(cloud, tmp_path / name)
        colours = np.asarray(o3d.io.read_point_cloud(str(tmp_path / name)).colors)
        np.testing.assert_allclose(colours, shares, atol=0.5 / 255)


def test_numbers_that_ply_cannot_hold_are_said(tmp_path):
    stamps = np.full((COUNT, 1), 1_700_000_000_123_456_789)
    cloud = from_attributes({"positions": NEAR, "stamp_ns": stamps}, 0)
    with pytest.warns(UserWarning, match="stamp_ns is left out"):
        save(cloud, tmp_path / "a.ply")
    for name in ("a.pcd", "a.npz"):
        save(cloud, tmp_path / name)
        np.testing.assert_array_equal(attributes(load(tmp_path / name))["stamp_ns"], stamps)


@pytest.mark.parametrize("ending", ["pcd", "ply", "npz"])
@pytest.mark.parametrize("place", [np.zeros(3), UTM], ids=["near", "utm"])
def test_fused_files(tmp_path, ending, place):
    """`coview fuse a.xyz --poses p.json --out x.ENDING`, opened as most people do."""
    np.savetxt(tmp_path / "a.xyz", NEAR)
    pose = np.eye(4)
    pose[:3, 3] = place
    (tmp_path / "p.json").write_text(json.dumps({"a": pose.tolist()}))
    out = tmp_path / f"x.{ending}"
    assert (
        run(
            [
                "fuse",
                str(tmp_path / "a.xyz"),
                "--poses",
                str(tmp_path / "p.json"),
                "--out",
                str(out),
            ]
        )
        == 0
    )
    if ending == "npz":
        with np.load(out) as arrays:
            points = arrays["positions"]
    else:
        points = np.asarray(o3d.io.read_point_cloud(str(out)).points)
    origin = stated_origin(out) if ending == "pcd" else np.zeros(3)
    assert origin.any() == (ending == "pcd" and place.any())
    np.testing.assert_allclose(
        np.sort(points + origin, axis=0), np.sort(NEAR + place, axis=0), atol=2e-4
    )
