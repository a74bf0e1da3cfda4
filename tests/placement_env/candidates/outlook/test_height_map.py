import numpy as np

from placement_env.candidates.outlook.height_map import HEIGHT_MARGIN, NOTHING, height_map
from toolkit.sites.site import Relief, Site, Solid

AREA = np.array([0.0, 0.0, 10.0, 6.0])


def square(x: float, y: float, side: float) -> np.ndarray:
    return np.array([[x, y], [x + side, y], [x + side, y + side], [x, y + side]])


def at(heights, layer: str, x: float, y: float) -> float:
    place = heights.places(np.array(x), np.array(y))
    return float(getattr(heights, layer).ravel()[place])


def test_what_stands_and_what_hangs():
    solids = (
        Solid(square(2, 2, 2), 0.0, 3.0, "building"),
        Solid(square(3, 2, 1), 0.0, 4.0, "building"),
        Solid(square(6, 3, 2), 2.0, 5.0, "tree"),
        Solid(square(6, 3, 1), 3.0, 6.0, "tree"),
    )
    heights = height_map(Site("heights", AREA, solids=solids))
    assert heights.top.shape == (6 + 2 * HEIGHT_MARGIN, 10 + 2 * HEIGHT_MARGIN)
    assert at(heights, "top", 2.5, 3.5) == 3
    assert at(heights, "top", 3.5, 2.5) == 4  # the higher of two
    assert at(heights, "top", 5.5, 0.5) == -NOTHING
    assert (at(heights, "low", 6.5, 3.5), at(heights, "high", 6.5, 3.5)) == (2, 6)
    assert at(heights, "top", 6.5, 3.5) == -NOTHING
    assert at(heights, "low", 2.5, 3.5) == NOTHING


def test_a_fence_thinner_than_a_place_is_there_and_a_post_is_not():
    fence = Solid(np.array([[1.0, 1.4], [9.0, 1.4], [9.0, 1.45], [1.0, 1.45]]), 0.0, 1.5, "fence")
    post = Solid(square(4.2, 4.2, 0.2), 0.0, 3.0, "post")
    heights = height_map(Site("thin", AREA, solids=(fence, post)))
    assert [at(heights, "top", x, 1.5) for x in (1.5, 5.5, 8.5)] == [1.5] * 3
    assert at(heights, "top", 4.5, 4.5) == -NOTHING


def test_whether_it_hangs_depends_on_the_ground_there():
    low = Solid(square(8, 0, 1), 1.2, 3.0, "hedge")
    level = height_map(Site("level", AREA, solids=(low,)))
    steep = height_map(Site("steep", AREA, solids=(low,), relief=Relief(slope=(0.15, 0.0))))
    assert at(level, "high", 8.5, 0.5) == 3
    assert at(steep, "high", 8.5, 0.5) == -NOTHING
    assert at(steep, "top", 8.5, 0.5) == 3


def test_without_solids_and_outside():
    heights = height_map(Site("bare", AREA, solids=(Solid(square(500, 500, 3), 0, 3),)))
    assert (heights.top == -NOTHING).all()
    assert heights.places(np.array([-900.0, 900.0]), np.array([-900.0, 900.0])).tolist() == [0, heights.top.size - 1]
