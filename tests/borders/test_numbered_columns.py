"""Text clouds whose first row or column is a number and no coordinate, and text as RFC 4180 and PTS
have it.

pandas' `to_csv` names the columns of an array 0, 1, 2 and numbers the rows; PTS files and
CloudCompare's text state the number of points above them (daavoo/pyntcloud#241, PDAL/PDAL#1508)."""

import io
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from toolkit.datasets.cloud_files import read_points

POINTS = np.round(np.random.default_rng(6).uniform(-20, 20, (30, 3)), 3)


def write(path: Path, content: str) -> Path:
    path.write_bytes(content.encode())
    return path


def format_rows(separator: str = " ", quote: str = "") -> str:
    lines = (separator.join(f"{quote}{value:.3f}{quote}" for value in row) for row in POINTS)
    return "\n".join(lines) + "\n"


def format_pandas(columns: list[str] | None = None, *, index: bool) -> str:
    stream = io.StringIO()
    pd.DataFrame(POINTS, columns=columns).to_csv(stream, index=index)
    return stream.getvalue()


@pytest.mark.parametrize("width", [3, 4])
def test_a_row_that_numbers_the_columns_is_no_point(tmp_path, width):
    table = pd.DataFrame(np.column_stack([POINTS, np.full(len(POINTS), 7.5)])[:, :width])
    path = tmp_path / "a.csv"
    table.to_csv(path, index=False)
    with pytest.warns(
        UserWarning, match="its first row, 0 1 2.*, numbers the columns and is left out"
    ):
        np.testing.assert_allclose(read_points(path), POINTS)


def test_a_column_that_numbers_the_rows_is_not_x(tmp_path):
    named = write(tmp_path / "named.csv", format_pandas(["x", "y", "z"], index=True))
    np.testing.assert_allclose(read_points(named), POINTS)
    lines = "".join(f"{k + 1} {line}\n" for k, line in enumerate(format_rows().splitlines()))
    for name in ("from_0.xyz", "from_1.xyz"):
        start = 1 if name == "from_1.xyz" else 0
        lines = "".join(
            f"{k + start} {line}\n" for k, line in enumerate(format_rows().splitlines())
        )
        with pytest.raises(
            ValueError, match="numbers its rows in the first column: name the columns"
        ):
            read_points(write(tmp_path / name, lines))


@pytest.mark.parametrize("header", ["", "x y z\n", "//X Y Z\n"])
def test_the_number_of_points_above_them(tmp_path, header):
    path = write(tmp_path / "a.xyz", f"{header}{len(POINTS)}\n{format_rows()}")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_allclose(read_points(path), POINTS)


def test_another_number_above_the_points_is_refused(tmp_path):
    path = write(tmp_path / "a.xyz", f"{len(POINTS) + 1}\n{format_rows()}")
    with pytest.raises(ValueError, match="as many cells in each row as names, got rows of 1 and 3"):
        read_points(path)


def test_quoted_numbers(tmp_path):
    np.testing.assert_allclose(
        read_points(write(tmp_path / "a.csv", f'"x","y","z"\n{format_rows(",", chr(34))}')), POINTS
    )


@pytest.mark.parametrize("row", ['"1,5","2,5","3,5"', "1,5 2,5 3,5"])
def test_decimal_commas_are_refused_by_name(tmp_path, row):
    with pytest.raises(ValueError, match="no decimal commas: write points"):
        read_points(write(tmp_path / "a.csv", f"{row}\n{row}\n"))


def test_a_cell_that_is_no_number_is_named(tmp_path):
    with pytest.raises(ValueError, match="numbers with decimal points only, got '1,5, 2, 3'"):
        read_points(write(tmp_path / "a.csv", "x;y;z\n1.5;2;3\n1,5;2;3\n"))
    with pytest.raises(ValueError, match="got 'm, m, m'"):
        read_points(write(tmp_path / "b.csv", "x,y,z\nm,m,m\n1,2,3\n"))


def test_rows_of_five_floats_called_bin_are_named(tmp_path):
    """nutonomy/nuscenes-devkit's clouds end in .pcd.bin: x y z intensity ring. Here no coordinate
    is below 0."""
    count = 400
    rng = np.random.default_rng(2)
    rows = np.column_stack([rng.uniform(0, 60, (count, 4)), rng.integers(0, 32, count)]).astype(
        "<f4"
    )
    rows.tofile(tmp_path / "a.bin")
    rows.tofile(tmp_path / "a.pcd.bin")
    rows[:, :4].tofile(tmp_path / "b.bin")
    with pytest.raises(
        ValueError, match=r"but fits 5 columns, the last of whole numbers.*call it \.pcd\.bin"
    ):
        read_points(tmp_path / "a.bin")
    for name in ("a.pcd.bin", "b.bin"):
        np.testing.assert_array_equal(read_points(tmp_path / name), rows[:, :3])


def test_an_archive_without_positions_lists_its_arrays(tmp_path):
    np.savez(tmp_path / "a.npz", points=POINTS)
    with pytest.raises(
        ValueError, match=r"its array positions must be .*, got points float64 \(30, 3\)"
    ):
        read_points(tmp_path / "a.npz")
