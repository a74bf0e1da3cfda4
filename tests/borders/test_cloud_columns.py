"""Coordinates of a point file: by the names of its columns, in the unit they name, or refused with
the columns."""

import warnings

import numpy as np
import pandas as pd
import pytest

from toolkit.clouds import attributes, load
from toolkit.datasets.cloud_files import fuse_files, read_recorded
from toolkit.datasets.pose_files import read_poses
from toolkit.point_columns import find_axes

POINTS = np.array([[1.5, -2.25, 0.5], [3.0, 4.0, 5.0], [-7.5, 0.25, 1.0]])
INTENSITY = np.array([11.0, 12.0, 13.0])

# header, metres that 1 of a coordinate is, order of the columns (i intensity)
HEADERS = [
    ("intensity,x_m,y_m,z_m", 1.0, "ixyz"),
    (
        '"intensity","Points_m_XYZ:0","Points_m_XYZ:1","Points_m_XYZ:2"',
        1.0,
        "ixyz",
    ),  # VeloView and LidarView
    ("Points:0,Points:1,Points:2,intensity", 1.0, "xyzi"),  # ParaView until 5.11
    ("intensity,Points_0,Points_1,Points_2", 1.0, "ixyz"),  # and since
    ("X (mm),Y (mm),Z (mm),intensity", 0.001, "xyzi"),
    ("intensity;X [cm];Y [cm];Z [cm]", 0.01, "ixyz"),
    ("intensity\tposX\tposY\tposZ", 1.0, "ixyz"),
    ("intensity x_mm y_mm z_mm", 0.001, "ixyz"),
    ("z,y,x,intensity", 1.0, "zyxi"),
    ("//Intensity,X,Y,Z", 1.0, "ixyz"),  # CloudCompare writes the names in a comment
    ("# intensity x y z", 1.0, "ixyz"),  # and so does numpy.savetxt
    ("intensity,point.x,point.y,point.z", 1.0, "ixyz"),
    ("intensity,x_lidar,y_lidar,z_lidar", 1.0, "ixyz"),
    ("Intensity,X,Y,Z", 1.0, "ixyz"),
    ("intensity,xCoord,yCoord,zCoord", 1.0, "ixyz"),
]


def separator_of(header):
    return next((mark for mark in (";", ",", "\t") if mark in header), " ")


def write_rows(path, header, order, metres=1.0):
    columns = dict(zip("xyz", (POINTS / metres).T, strict=True)) | {"i": INTENSITY}
    separator = separator_of(header)
    rows = [separator.join(f"{columns[name][k]:.6f}" for name in order) for k in range(len(POINTS))]
    path.write_text("\n".join([header, *rows]) + "\n")


@pytest.mark.parametrize(("header", "metres", "order"), HEADERS)
def test_text_is_read_by_its_names_and_units(tmp_path, header, metres, order):
    write_rows(tmp_path / "a.csv", header, order, metres)
    recorded = read_recorded(tmp_path / "a.csv")
    np.testing.assert_allclose(recorded["positions"], POINTS, atol=1e-9)
    np.testing.assert_array_equal(recorded["intensity"][:, 0], INTENSITY)


@pytest.mark.parametrize(
    ("header", "listed"),
    [
        ("azimuth,range,elevation,intensity", "azimuth, range, elevation"),
        ("longitude,latitude,altitude,intensity", "longitude, latitude, altitude"),
        ("x_ft,y_ft,z_ft,intensity", "in ft"),
        ("x_lidar,y_lidar,z_lidar,x_map,y_map,z_map", "2 sets of coordinates"),
        ("x_m,y_m,z_m,x_mm,y_mm,z_mm", "2 sets of coordinates"),
        ("vx,vy,vz,intensity", "vx, vy, vz"),
        ("nx,ny,nz,intensity", "nx, ny, nz"),
        ("x,y,intensity,time", "no column z"),
        ("a,b,c,d", "a, b, c, d"),
        ("x,y,z,x", "once"),
    ],
)
def test_other_names_are_refused_with_the_columns(tmp_path, header, listed):
    row = ",".join("1.0" for _ in header.split(","))
    (tmp_path / "a.csv").write_text(f"{header}\n{row}\n{row}\n")
    with pytest.raises(ValueError, match=listed):
        read_recorded(tmp_path / "a.csv")


def test_comment_without_coordinates_is_no_header(tmp_path):
    (tmp_path / "a.xyz").write_text("# scanned in May, north\n1 2 3 9\n4 5 6 9\n")
    np.testing.assert_array_equal(
        read_recorded(tmp_path / "a.xyz")["positions"], [[1, 2, 3], [4, 5, 6]]
    )


def test_tables_are_read_by_name(tmp_path):
    frame = pd.DataFrame({"Intensity": INTENSITY, "X_mm": POINTS[:, 0] * 1000})
    frame["Y_mm"], frame["Z_mm"] = POINTS[:, 1] * 1000, POINTS[:, 2] * 1000
    frame.to_feather(tmp_path / "a.feather")
    np.save(tmp_path / "a.npy", frame.to_records(index=False))
    for name in ("a.feather", "a.npy"):
        np.testing.assert_allclose(read_recorded(tmp_path / name)["positions"], POINTS, atol=1e-9)


def test_table_of_whole_millimetres_keeps_them(tmp_path):
    """Registers of 32 bits in millimetres, as a device's own export has them."""
    table = np.zeros(3, [("z (mm)", "<i4"), ("x (mm)", "<i4"), ("y (mm)", "<i4")])
    for k, axis in enumerate("xyz"):
        table[f"{axis} (mm)"] = np.round(POINTS[:, k] * 1000)
    np.save(tmp_path / "a.npy", table)
    np.testing.assert_allclose(read_recorded(tmp_path / "a.npy")["positions"], POINTS, atol=1e-12)


def test_exact_names_win_over_described_ones():
    assert find_axes(["x_lidar", "y_lidar", "z_lidar", "x", "y", "z"]).names == ("x", "y", "z")
    assert find_axes(["X", "Y", "Z", "x", "y", "z"]).names == ("x", "y", "z")


@pytest.mark.parametrize("spelled", ["COLUMNS x y z", "FIELDS x y z"])
def test_pcd_of_version_05(tmp_path, spelled):
    """PCL's PCD before 0.6 says COLUMNS for FIELDS, and has no SIZE and TYPE: floats of 4 bytes."""
    rows = "\n".join(" ".join(map(str, point)) for point in POINTS)
    (tmp_path / "a.pcd").write_text(
        f"# .PCD v.5\nVERSION .5\n{spelled}\nPOINTS 3\nDATA ascii\n{rows}\n"
    )
    np.testing.assert_array_equal(attributes(load(tmp_path / "a.pcd"))["positions"], POINTS)


def test_pcd_with_sizes_and_columns(tmp_path):
    header = (
        "VERSION 0.5\nCOLUMNS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 3\nHEIGHT "
        "1\nPOINTS 3\nDATA binary\n"
    )
    (tmp_path / "a.pcd").write_bytes(header.encode() + POINTS.astype("<f4").tobytes())
    np.testing.assert_array_equal(attributes(load(tmp_path / "a.pcd"))["positions"], POINTS)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        (
            "a.ply",
            "ply\nformat ascii 1.0\ncomment offset: 692000 5336000 500\nelement vertex 1\n"
            "property double x\nproperty double y\nproperty double z\nend_header\n1 2 3\n",
        ),
        (
            "a.pcd",
            (
                "# global shift 692000.0, 5336000.0, 500.0\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F "
                "F\nPOINTS 1\nDATA ascii\n1 2 3\n"
            ),
        ),
        ("a.xyz", "// Global Shift = 692000 5336000 500\n1 2 3\n"),
    ],
)
def test_offset_in_a_comment_is_said(tmp_path, name, content):
    """Programs leave an origin in comments, in words of their choice: never dropped without a
    word."""
    (tmp_path / name).write_text(content)
    with pytest.warns(UserWarning, match="692000"):
        recorded = read_recorded(tmp_path / name)
    np.testing.assert_array_equal(recorded["positions"], [[1, 2, 3]])


def test_ordinary_comments_are_quiet(tmp_path):
    (tmp_path / "a.xyz").write_text("# 3 returns of origin lidar 2, 10 Hz\n1 2 3\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_recorded(tmp_path / "a.xyz")


def test_coordinates_that_float32_rounded_are_said(tmp_path):
    places = np.array([692000.0, 5336000.0, 520.0]) + POINTS
    np.save(tmp_path / "single.npy", places.astype(np.float32))
    np.save(tmp_path / "double.npy", places + 0.013)
    with pytest.warns(UserWarning, match=r"rounded to 0\.5 m"):
        fuse_files([tmp_path / "single.npy"], [np.eye(4)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fuse_files([tmp_path / "double.npy"], [np.eye(4)])


def test_poses_that_end_in_their_quaternion(tmp_path):
    """TUM trajectories: timestamp tx ty tz qx qy qz qw."""
    (tmp_path / "tum.txt").write_text("north 5 3 6 0 0 0.6 0.8\n")
    with pytest.raises(ValueError, match="write qw qx qy qz tx ty tz"):
        read_poses(tmp_path / "tum.txt")
    (tmp_path / "both.txt").write_text("north 1 0 0 0 0.6 0 0.8\n")
    with pytest.warns(UserWarning, match="might be tx ty tz qx qy qz qw"):
        read_poses(tmp_path / "both.txt")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        (tmp_path / "plain.txt").write_text("north 1 0 0 0 0 0 1\nsouth 0.8 0 0 0.6 5 3 6\n")
        read_poses(tmp_path / "plain.txt")


def test_a_header_with_a_very_long_cell_still_names_its_axes(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"{'n' * 200_000},x,y,z\n1,2,3,4\n")
    np.testing.assert_array_equal(read_recorded(path)["positions"], [[2, 3, 4]])
