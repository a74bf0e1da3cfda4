import numpy as np

from toolkit.viewing.box_lines import EDGES, box_edges, dashed, headings, roof_crosses, sampled, spikes

BOX = np.array([[1.0, 2.0, 0.75, 4.0, 2.0, 1.5, 0.0]])


def test_a_heading_points_ahead():
    turned = BOX + np.array([0, 0, 0, 0, 0, 0, np.pi / 2])
    np.testing.assert_allclose(headings(turned), [[[1, 2, 1.5], [1, 4, 1.5]]], atol=1e-12)
    assert headings(np.zeros((0, 7))).shape == (0, 2, 3)


def test_a_box_has_twelve_edges_a_cross_and_a_mast():
    edges = box_edges(BOX)
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    assert sorted(lengths.round(6)) == [1.5] * 4 + [2.0] * 4 + [4.0] * 4
    assert len(EDGES) == 12
    cross = roof_crosses(BOX)
    np.testing.assert_allclose(cross[..., 2], 1.5)
    np.testing.assert_allclose(np.linalg.norm(cross[:, 1] - cross[:, 0], axis=1), np.sqrt(20))
    mast = spikes(BOX)
    np.testing.assert_allclose(mast[0], [[1, 2, 1.5], [1, 2, 4.0]])
    assert mast.shape == (3, 2, 3)


def test_no_boxes_no_marks():
    none = np.zeros((0, 7))
    assert [len(make(none)) for make in (box_edges, roof_crosses, spikes)] == [0, 0, 0]
    assert dashed(np.zeros((0, 2, 3)), dash=1.0, gap=1.0).shape == (0, 2, 3)


def test_dashes_keep_to_the_line():
    dashes = dashed(np.array([[[0.0, 0, 0], [0, 10, 0]]]), dash=1.0, gap=1.5)
    np.testing.assert_allclose(dashes[:, :, 1], [[0, 1], [2.5, 3.5], [5, 6], [7.5, 8.5]])


def test_thinning_takes_points_evenly_and_leaves_few_alone():
    points = np.arange(30, dtype=np.float32).reshape(10, 3)
    assert sampled(points, 10) is points
    np.testing.assert_array_equal(sampled(points, 5)[:, 0], [0, 6, 12, 18, 24])
