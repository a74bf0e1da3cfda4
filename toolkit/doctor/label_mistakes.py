"""Classic mistakes in the labels of clouds."""

import numpy as np

from toolkit.doctor.label_mistake import LabelMistake

_MIRROR_X = "negate x, and take 180 degrees minus yaw"
_SWAP = "swap x and y, and take 90 degrees minus yaw"
_HALVED = "half extents where full ones belong: the boxes are half as large"
_DOUBLED = "doubled extents: the boxes are twice as large"
# Orders and factors below are of the columns x, y, z, length, width, height and yaw.
_HALF = (1, 1, 1, 0.5, 0.5, 0.5, 1)
_ACROSS = "length and width swapped, or yaw a quarter turn off"
_ADD_QUARTER = "swap length and width, or add 90 degrees to yaw"
_RADIANS = "yaw in radians where degrees belong"
_TO_DEGREES = (1, 1, 1, 1, 1, 1, 180 / np.pi)
YAW_SIGN = LabelMistake(
    name="yaw counted the other way round",
    remedy="negate yaw",
    depends_on_axes=True,
    column_factors=(1, 1, 1, 1, 1, 1, -1),
)
LOST_DEGREES = LabelMistake(  # not undone directly: `possible_headings` gives the possible angles
    "yaw in degrees where radians belong, of which only sine and cosine are left",
    "multiply yaw by pi / 180 before its sine and cosine are taken",
)
LABEL_MISTAKES = (  # the first is named if several fit about as well
    LabelMistake(
        name="mirrored: y points the other way",
        remedy="negate y and yaw",
        depends_on_axes=True,
        column_factors=(1, -1, 1, 1, 1, 1, -1),
    ),
    LabelMistake(
        name="mirrored: x points the other way",
        remedy=_MIRROR_X,
        depends_on_axes=True,
        column_factors=(-1, 1, 1, 1, 1, 1, -1),
        yaw_turn=np.pi,
    ),
    LabelMistake(
        name="y of the positions alone negated",
        remedy="negate y",
        depends_on_axes=True,
        column_factors=(1, -1, 1, 1, 1, 1, 1),
    ),
    LabelMistake(
        name="x and y swapped",
        remedy=_SWAP,
        depends_on_axes=True,
        column_order=(1, 0, 2, 3, 4, 5, 6),
        column_factors=(1, 1, 1, 1, 1, 1, -1),
        yaw_turn=np.pi / 2,
    ),
    LabelMistake(_HALVED, "double the sizes", column_factors=(1, 1, 1, 2, 2, 2, 1)),
    LabelMistake(_DOUBLED, "halve the sizes", column_factors=_HALF),
    LabelMistake(_ACROSS, _ADD_QUARTER, column_order=(0, 1, 2, 4, 3, 5, 6)),
    YAW_SIGN,
    LabelMistake(
        name=_RADIANS,
        remedy="multiply yaw by 180 / pi",
        depends_on_axes=True,
        column_factors=_TO_DEGREES,
    ),
)
