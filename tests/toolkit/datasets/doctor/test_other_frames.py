import numpy as np
import pytest

from toolkit.datasets.doctor.other_frames import suspect_frames

LEVEL = np.eye(4)


def shifted(file, off):
    """Objects of frame k beside the images of frame k + off; none where there is no such frame."""
    file.move("objects", "others")
    file.create_group("objects").attrs.update(file["others"].attrs)
    for k in range(14):
        source = k - off
        file[f"objects/{k}"] = file[f"others/{source}"][()] if 0 <= source < 14 else np.zeros((0, 10))
    del file["others"]


@pytest.mark.parametrize(
    ("off", "said"),
    [(1, "labels lie about 1 frame behind the images"), (-1, "labels lie about 1 frame ahead of the images"),
     (3, "labels lie about 3 frames behind the images")],
)  # fmt: skip
def test_objects_of_frames_before_or_after(spoil, off, said):
    found = [finding for finding in spoil(lambda file: shifted(file, off), True) if finding.severity == "error"]
    assert [finding.suspected for finding in found] == [said]
    assert found[0].remedy == f"store objects/K as objects/K{'-' if off > 0 else '+'}{abs(off)}"


def rows(x):
    return np.array([[x, 0.0, 0.8, 0.0, 0.0, 0.0, 2.0, 1.0, 0.8, 0.0]])


def side(x, count=100):
    """Points on the near side of the box at x, of a right-handed map."""
    return np.column_stack([np.linspace(x - 1.9, x + 1.9, count), np.full(count, -1.0), np.full(count, 1.0)])


def test_rows_that_belong_to_the_frames_are_given_back():
    tables = [rows(10.0 * k) for k in range(6)]
    clouds = [side(10.0 * (k + 2)) for k in (0, 2, 4)]
    suspicion, own = suspect_frames(clouds, tables, [0, 2, 4], LEVEL)
    assert (suspicion.before, suspicion.after) == (0.0, 1.0)
    assert [table[0, 0] if len(table) else None for table in own] == [20.0, 40.0, None]
    sound, own = suspect_frames([side(10.0 * k) for k in (0, 2, 4)], tables, [0, 2, 4], LEVEL)
    assert sound is None
    assert [table[0, 0] for table in own] == [0.0, 20.0, 40.0]


def test_few_points_and_empty_frames_say_nothing():
    tables = [rows(10.0 * k) for k in range(6)]
    assert suspect_frames([side(20.0, 99)] * 2, tables, [0, 1], LEVEL)[0] is None
    assert suspect_frames([side(20.0)] * 2, [table[:0] for table in tables], [0, 1], LEVEL)[0] is None
