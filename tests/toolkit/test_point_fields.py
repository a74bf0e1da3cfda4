import numpy as np
import pytest

from toolkit.point_fields import attributes_of

XYZ = {axis: np.arange(4.0) for axis in "xyz"}


def test_packed_colours_are_taken_apart():
    word = np.array([0xFF8001, 0, 0x0000FF, 0x010203], np.uint32)
    for column in (word, word.view(np.float32), word[:, None]):
        colours = attributes_of({**XYZ, "rgb": column})["colors"]
        assert colours.tolist() == [[255, 128, 1], [0, 0, 0], [0, 0, 255], [1, 2, 3]]


@pytest.mark.parametrize("names", [("normal_x", "normal_y", "normal_z"), ("nx", "ny", "nz")])
def test_normals_have_the_type_of_positions(names):
    made = attributes_of(
        {axis: column.astype(np.float32) for axis, column in XYZ.items()} | dict.fromkeys(names, XYZ["x"])
    )
    assert made["normals"].shape == (4, 3)
    assert made["normals"].dtype == made["positions"].dtype == np.float32


def test_columns_of_texts_are_left_out_and_whole_positions_become_float64():
    made = attributes_of({**{axis: np.arange(4) for axis in "xyz"}, "word": np.array(["a"] * 4), "t": np.arange(4)})
    assert made.keys() == {"positions", "t"}
    assert made["positions"].dtype == np.float64
