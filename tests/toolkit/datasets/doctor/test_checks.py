"""What measurements say about sensors and objects."""

import numpy as np
import pytest

from toolkit.geometry import pose


def blind(file):
    for k in range(len(file["dslices"])):
        file["dslices"][k] = 1000


def place(change):
    """Change the place of the first camera, world → camera."""

    def moved(file):
        file["cameras/d00/extrinsic"][...] = change(file["cameras/d00/extrinsic"][()])

    return moved


@pytest.mark.parametrize(
    ("change", "suspected"),
    [
        (blind, "no points"),
        (place(lambda matrix: matrix @ pose(0.0, 0.0, 9.0)), "it stands under the ground"),
        (place(lambda matrix: np.diag([1, -1, -1, 1]) @ matrix), "upside down"),
    ],
)
def test_a_sensor_that_cannot_be_right_is_named(spoil, change, suspected):
    findings = spoil(change)
    assert any(suspected in finding.suspected and "sensor north" in finding.where for finding in findings)


def test_a_dark_frame(spoil):
    def darken(file):
        for name in ("dslices", "coview/ranges/lidar"):
            file[name][4] = 0

    (finding,) = spoil(darken)
    assert (finding.where, finding.suspected) == ("frame 4", "frames without points")
    assert str(finding) == (
        "error: frame 4: frames without points (1 of 14 frames that were looked at, the first is 4);"
        " restore their images or leave them out"
    )


def test_objects_of_other_frames(spoil):
    def turn_over(file):
        file.move("objects", "others")
        for k in range(14):
            file[f"objects/{k}"] = file[f"others/{(k + 5) % 14}"][()]

    assert any("points and boxes disagree" in finding.suspected for finding in spoil(turn_over))
