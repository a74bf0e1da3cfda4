"""Shapes in types: `Float[np.ndarray, "n 7"]`, checked by jaxtyping while the tests run, plain
arrays elsewhere. A bare training machine has no jaxtyping; there the annotations mean the array
alone."""

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING or find_spec("jaxtyping"):
    from jaxtyping import (
        Bool as Bool,
        Float as Float,
        Float32 as Float32,
        Float64 as Float64,
        Int as Int,
        Int32 as Int32,
        Int64 as Int64,
        Shaped as Shaped,
        UInt8 as UInt8,
    )
else:

    class _Unchecked:
        def __class_getitem__(cls, array_and_shape: tuple[Any, str]) -> Any:
            return array_and_shape[0]

    Bool = Float = Float32 = Float64 = Int = Int32 = Int64 = Shaped = UInt8 = _Unchecked

ImageMask = Bool[np.ndarray, "rows columns"]
ImageRanges = Float32[np.ndarray, "rows columns"]
ImageSteps = Int64[np.ndarray, "rows columns"]  # measurements in whole steps
ImageVectors = Float32[np.ndarray, "rows columns 3"]
Pose = Float[np.ndarray, "4 4"]  # target_SE3_source
Points = Float[np.ndarray, "n 3"]  # m
BoxRows = Float[np.ndarray, "n 7"]  # see `toolkit.boxes`
FrameBoxes = Float[np.ndarray, "_ 7"]  # of one of several frames that differ in number
Mask = Bool[np.ndarray, " n"]
Rng = np.random.Generator
