"""Classic mistakes, each made in a healthy recording and called by its name."""

import numpy as np
import pytest

from toolkit.doctor.frame_shifts import suspect_frames


def columns(**changes):
    """Change columns of all objects: y, yaw, l, ... as functions of the old ones."""
    names = {"x": 0, "y": 1, "z": 2, "yaw": 5, "l": 6, "w": 7, "h": 8}

    def change(file):
        for rows in file["objects"].values():
            old, new = rows[()], rows[()]
            for name, function in changes.items():
                new[:, names[name]] = function({key: old[:, i] for key, i in names.items()})
            rows[...] = new

    return change


def extrinsics(function, only=("d00", "d01")):
    def change(file):
        for name in only:
            file[f"cameras/{name}/extrinsic"][...] = function(file[f"cameras/{name}/extrinsic"][()])

    return change


def depths(function):
    def change(file):
        for k in range(len(file["dslices"])):
            file["dslices"][k] = function(file["dslices"][k], k)

    return change


MIRROR = np.diag([1.0, -1, 1, 1])
U, V = np.meshgrid((np.arange(160) - 80) / 80, (np.arange(120) - 60) / 80)

MISTAKES = (
    (columns(y=lambda o: -o["y"], yaw=lambda o: -o["yaw"]), "mirrored y axis"),
    (columns(yaw=lambda o: -o["yaw"]), "yaw counted the other way round"),
    (columns(yaw=lambda o: np.deg2rad(o["yaw"])), "yaw in radians"),
    (columns(yaw=lambda o: np.rad2deg(o["yaw"])), "yaw turned from radians to degrees twice"),
    (
        columns(l=lambda o: 2 * o["l"], w=lambda o: 2 * o["w"], h=lambda o: 2 * o["h"]),
        "full extents",
    ),
    (
        columns(l=lambda o: o["l"] / 2, w=lambda o: o["w"] / 2, h=lambda o: o["h"] / 2),
        "half of the half extents",
    ),
    (columns(l=lambda o: o["w"], w=lambda o: o["l"]), "length and width swapped"),
    (
        columns(x=lambda o: o["y"], y=lambda o: o["x"], yaw=lambda o: 90 - o["yaw"]),
        "x and y swapped",
    ),
    (columns(z=lambda o: o["z"] - o["h"]), "the centre of the floor"),
    (columns(z=lambda o: o["z"] + 0.6), "the boxes float above the ground"),
    (columns(z=lambda o: o["z"] - 0.4), "the boxes are sunk into the ground"),
    (extrinsics(np.linalg.inv), "its extrinsic is camera → world"),
    (extrinsics(np.linalg.inv, ["d01"]), "its extrinsic is camera → world"),
    (extrinsics(lambda matrix: MIRROR @ matrix @ MIRROR), "camera with x forward, y left, z up"),
    (extrinsics(lambda matrix: np.diag([-1, -1, 1, 1]) @ matrix, ["d00"]), "it looks away"),
    (depths(lambda depth, k: 1000 * depth), "depth in millimetres"),
    (depths(lambda depth, k: np.where(depth < 999, 100 * depth, 0)), "depth in centimetres"),
    (depths(lambda depth, k: depth / 1000), "depth in parts of the far plane"),
    (
        depths(lambda depth, k: depth * np.sqrt(1 + U**2 + V**2)),
        "its depth is the distance along the ray",
    ),
)


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    ("change", "suspected", "published"),
    [*((*m, False) for m in MISTAKES), *((*m, True) for m in MISTAKES[::4])],
)
def test_classic_mistakes(spoil, change, suspected, published):
    findings = spoil(change, published)
    assert suspected in findings[0].suspected
    assert findings[0].severity == "error"
    assert {finding.suspected for finding in findings} == {findings[0].suspected}
    assert findings[0].evidence
    assert findings[0].remedy


LEVEL = np.eye(4)


def shifted(file, off):
    """Objects of frame k beside the images of frame k + off; none where there is no such frame."""
    file.move("objects", "others")
    file.create_group("objects").attrs.update(file["others"].attrs)
    for k in range(14):
        source = k - off
        file[f"objects/{k}"] = (
            file[f"others/{source}"][()] if 0 <= source < 14 else np.zeros((0, 10))
        )
    del file["others"]


@pytest.mark.parametrize(
    ("off", "said"),
    [
        (1, "labels lie about 1 frame behind the images"),
        (-1, "labels lie about 1 frame ahead of the images"),
        (3, "labels lie about 3 frames behind the images"),
    ],
)
def test_objects_of_frames_before_or_after(spoil, off, said):
    found = [
        finding
        for finding in spoil(lambda file: shifted(file, off), True)
        if finding.severity == "error"
    ]
    assert [finding.suspected for finding in found] == [said]
    assert found[0].remedy == f"store objects/K as objects/K{'-' if off > 0 else '+'}{abs(off)}"


def rows(x):
    return np.array([[x, 0.0, 0.8, 0.0, 0.0, 0.0, 2.0, 1.0, 0.8, 0.0]])


def side(x, count=100):
    return np.column_stack(
        [np.linspace(x - 1.9, x + 1.9, count), np.full(count, -1.0), np.full(count, 1.0)]
    )


def test_rows_that_belong_to_the_frames_are_given_back():
    tables = [rows(10.0 * k) for k in range(6)]
    suspicion, own = suspect_frames(
        [side(10.0 * (k + 2)) for k in (0, 2, 4)], tables, [0, 2, 4], LEVEL
    )
    assert (suspicion.fit_before, suspicion.fit_after) == (0.0, 1.0)
    assert [table[0, 0] if len(table) else None for table in own] == [20.0, 40.0, None]
    sound, own = suspect_frames([side(10.0 * k) for k in (0, 2, 4)], tables, [0, 2, 4], LEVEL)
    assert sound is None
    assert [table[0, 0] for table in own] == [0.0, 20.0, 40.0]
    tables = [rows(10.0 * k) for k in range(6)]
    assert suspect_frames([side(20.0, 99)] * 2, tables, [0, 1], LEVEL)[0] is None
    assert (
        suspect_frames([side(20.0)] * 2, [table[:0] for table in tables], [0, 1], LEVEL)[0] is None
    )


def test_each_sensor_of_one_mistake_has_its_evidence(spoil):
    (finding,) = [
        each for each in spoil(extrinsics(np.linalg.inv)) if each.where.startswith("sensor")
    ]
    assert finding.where == "sensors north, west"
    north, west = finding.evidence.split("; ")
    assert north.startswith("north: ")
    assert west.startswith("west: ")
    (alone,) = [
        each
        for each in spoil(extrinsics(np.linalg.inv, ["d01"]))
        if each.where.startswith("sensor")
    ]
    assert west == f"west: {alone.evidence}"
