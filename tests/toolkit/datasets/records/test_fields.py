import json

import numpy as np
import pytest

from toolkit.datasets.records.fields import (
    Listing,
    as_number,
    entry,
    heading,
    named_damage,
    numbers,
    rigid,
    rigid_matrix,
)
from toolkit.datasets.sample import Sample
from toolkit.geometry import pose
from toolkit.objects import Objects


def test_a_listing_reads_when_asked():
    read = []

    def load(name):
        read.append(name)
        return Sample(name, (), Objects.empty())

    listing = Listing(("a", "b", "c"), load)
    assert len(listing) == 3
    assert listing[1].name == "b"
    assert read == ["b"]
    assert [sample.name for sample in listing] == ["a", "b", "c"]
    assert listing[-1].name == "c"


@pytest.mark.parametrize(
    ("damage", "names"),
    [
        (lambda: entry({"a": 1}, "a", "b"), "it has no entry a.b"),
        (lambda: as_number("x", "size"), "size must be a number, got 'x'"),
        (lambda: as_number(None, "size"), "size must be a number, got 'None'"),
        (lambda: numbers([1, [2]], 3, "size"), "size must be 3 numbers"),
        (lambda: numbers([1, "b", 2], 3, "size"), "size must be 3 numbers"),
        (lambda: json.loads("{}")["key"], "'key'"),
        (lambda: b"\xff".decode(), "byte 0 is not UTF-8"),
    ],
)
def test_damage_is_one_line_with_the_file(damage, names):
    with pytest.raises(ValueError, match=f"f.json .*{names}"), named_damage("f.json", "list"):
        damage()


def test_rotations_are_made_orthonormal_or_refused():
    off = pose(yaw=0.3)[:3, :3] + 0.004
    matrix = rigid(off, [1, 2, 3])
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.abs(matrix[:3, :3] - off).max() < 0.01
    for wrong in (np.diag([1.0, 1, -1]), 1.2 * np.eye(3), np.zeros((3, 3)), np.full((3, 3), np.nan)):
        with pytest.raises(ValueError, match="must turn by a rotation"):
            rigid(wrong, [0, 0, 0])
    with pytest.raises(ValueError, match="NaN"):
        rigid(np.eye(3), [np.nan, 0, 0])


def test_twelve_or_sixteen_numbers_are_a_pose():
    placed = pose(1.0, 2.0, 3.0, yaw=0.5)
    np.testing.assert_allclose(rigid_matrix(placed.tolist()), placed)
    np.testing.assert_allclose(rigid_matrix(placed[:3].ravel().astype(str)), placed)


def test_headings_turn_with_the_frame():
    np.testing.assert_allclose(heading(pose(9.0, yaw=0.25), [0.5, -3.0]), [0.75, -2.75])
    assert heading(np.diag([1.0, -1, 1, 1]), 0.5) == pytest.approx(-0.5)
