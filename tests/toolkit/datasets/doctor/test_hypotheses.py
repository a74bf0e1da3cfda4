"""Classic mistakes, each made in a healthy recording and called by its name."""

import numpy as np
import pytest


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
    (columns(l=lambda o: 2 * o["l"], w=lambda o: 2 * o["w"], h=lambda o: 2 * o["h"]), "full extents"),
    (columns(l=lambda o: o["l"] / 2, w=lambda o: o["w"] / 2, h=lambda o: o["h"] / 2), "half of the half extents"),
    (columns(l=lambda o: o["w"], w=lambda o: o["l"]), "length and width swapped"),
    (columns(x=lambda o: o["y"], y=lambda o: o["x"], yaw=lambda o: 90 - o["yaw"]), "x and y swapped"),
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
    (depths(lambda depth, k: depth * np.sqrt(1 + U**2 + V**2)), "its depth is the distance along the ray"),
)


@pytest.mark.parametrize(
    ("change", "suspected", "published"), [*((*m, False) for m in MISTAKES), *((*m, True) for m in MISTAKES[::4])]
)
def test_classic_mistakes(spoil, change, suspected, published):
    findings = spoil(change, published)
    assert suspected in findings[0].suspected
    assert findings[0].severity == "error"
    assert {finding.suspected for finding in findings} == {findings[0].suspected}
    assert findings[0].evidence
    assert findings[0].remedy
