"""Classic mistakes in the stored columns of objects, and how to undo them."""

import numpy as np

from toolkit.doctor.site_area import MIRROR_Y
from toolkit.doctor.suspicions import Mistake

_FULL = "full extents stored where half extents belong: the boxes are twice too large"
_HALVED = "half of the half extents stored: the boxes are half as large as their objects"
_RADIANS = "yaw in radians where degrees belong"
_TWICE = "yaw turned from radians to degrees twice"
_NEGATE_YAW = "negate column 5 of objects: CARLA's y points the other way, so does its yaw"
_MIRRORED = "mirrored y axis: a right-handed world where CARLA's left-handed one belongs"
_MIRROR_X = "negate column 0 (x) of objects and take 180 degrees minus column 5 (yaw)"
_SWAP = "swap columns 0 and 1 of objects and take 90 degrees minus column 5 (yaw)"
_END = (
    "the centre of the {} stored where the centre of the box belongs: the boxes {} by half their "
    "height"
)
_ADD = "add column 8 (half height) to column 2 (z) of objects"
_SUBTRACT = "subtract column 8 (half height) from column 2 (z) of objects"
# `o` holds published columns by short names: x, y, z, yaw (degrees), and l, w, h, half extents (m)
OBJECT_MISTAKES = (  # each: the mistake in words, its remedy in words, and how to undo it
    Mistake(_FULL, "halve columns 6 to 8 of objects", lambda o: {key: o[key] / 2 for key in "lwh"}),
    Mistake(
        _HALVED, "double columns 6 to 8 of objects", lambda o: {key: o[key] * 2 for key in "lwh"}
    ),
    Mistake(
        "length and width swapped",
        "swap columns 6 and 7 of objects",
        lambda o: {"l": o["w"], "w": o["l"]},
    ),
    Mistake(
        _RADIANS,
        "multiply column 5 of objects by 180 / pi",
        lambda o: {"yaw": np.rad2deg(o["yaw"])},
    ),
    Mistake(
        _TWICE, "multiply column 5 of objects by pi / 180", lambda o: {"yaw": np.deg2rad(o["yaw"])}
    ),
    Mistake("yaw counted the other way round", _NEGATE_YAW, lambda o: {"yaw": -o["yaw"]}),
    Mistake(
        "yaw a quarter turn off",
        "add 90 degrees to column 5 of objects",
        lambda o: {"yaw": o["yaw"] + 90},
    ),
    Mistake(_MIRRORED, MIRROR_Y, lambda o: {"y": -o["y"], "yaw": -o["yaw"]}),
    Mistake(
        "mirrored y axis, of the positions alone",
        "negate column 1 (y) of objects",
        lambda o: {"y": -o["y"]},
    ),
    Mistake("mirrored x axis", _MIRROR_X, lambda o: {"x": -o["x"], "yaw": 180 - o["yaw"]}),
    Mistake("x and y swapped", _SWAP, lambda o: {"x": o["y"], "y": o["x"], "yaw": 90 - o["yaw"]}),
    Mistake(_END.format("floor", "are sunk"), _ADD, lambda o: {"z": o["z"] + o["h"]}),
    Mistake(_END.format("roof", "float"), _SUBTRACT, lambda o: {"z": o["z"] - o["h"]}),
)
LIFTED = tuple(  # boxes that are too high by `lift` (m), or too low if negative
    Mistake(
        (
            f"the boxes {'float above' if lift > 0 else 'are sunk into'} the ground, by about "
            f"{abs(lift):.1f} m"
        ),
        (
            f"{'subtract' if lift > 0 else 'add'} {abs(lift):.1f} m {'from' if lift > 0 else 'to'} "
            "column 2 (z) of objects"
        ),
        lambda o, lift=lift: {"z": o["z"] - lift},
    )
    for lift in (0.3, 0.4, 0.5, 0.6, 0.8, 1.0, -0.3, -0.4, -0.5, -0.6, -0.8, -1.0)
)
