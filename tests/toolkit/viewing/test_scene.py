from pathlib import Path

import numpy as np
import pytest

from toolkit.mesh import box, merge
from toolkit.viewing import box_lines, pages, scene, scene_parts


def test_the_camera_sees_the_area():
    assert scene.rgb("#0a10ff") == (10, 16, 255)
    position, look_at = scene.overview((0.0, 0.0, 40.0, 20.0), height=2.0)
    assert look_at == (20.0, 10.0, 2.0)
    assert position == (14.0, -20.0, 28.0)


def test_points_are_thinned_evenly():
    points = np.arange(30, dtype=np.float32).reshape(10, 3)
    assert scene_parts.thin_evenly(points, 10) is points
    np.testing.assert_array_equal(scene_parts.thin_evenly(points, 5)[:, 0], [0, 6, 12, 18, 24])


def test_scripts_are_safe_in_pages():
    assert pages.POLICY.startswith("default-src 'none';")
    assert "http" not in pages.POLICY
    assert " 'unsafe-eval'" not in pages.POLICY
    assert (
        pages.script_data({"a": "</script><!--\u2028"})
        == '{"a": "\\u003c/script>\\u003c!--\\u2028"}'
    )
    script = (Path(scene.__file__).parent / "scene.js").read_text()
    assert script.startswith('"use strict";')
    assert "</script" not in script


def test_the_server_is_for_this_machine_alone_and_ends(capsys):
    with scene.viser_server() as server:
        assert server.get_host() == "127.0.0.1"
        scene_parts.add_mesh(server.scene, "/box", box((1, 1, 1)), "#112233")
        scene_parts.add_mesh(server.scene, "/nothing", merge([]), "#112233")
        assert (
            scene_parts.add_lines(
                server.scene, "/none", np.zeros((0, 2, 3)), "#112233", width=1.0, visible=True
            )
            is None
        )
        lines = scene_parts.add_lines(
            server.scene, "/line", np.ones((1, 2, 3)), "#112233", width=3.0, visible=False
        )
        assert (lines.name, lines.visible, lines.points.shape) == ("/line", False, (1, 2, 3))
        scene.set_view(server, (0.0, -10.0, 5.0), (1.0, 2.0, 3.0))
        np.testing.assert_array_equal(server.initial_camera.look_at, [1, 2, 3])
        html = scene.scene_html(server)
    assert html.index("scene: {ready: true}") < html.index("</head>")
    assert capsys.readouterr() == ("", "")


def test_without_viser_it_says_what_to_install(without_packages):
    without_packages("viser")
    with pytest.raises(ImportError, match=r"need viser: pip install coview\[report\]"):
        scene.check_viser()
    with pytest.raises(ImportError, match=r"coview\[report\]"), scene.viser_server():
        pytest.fail("never here")


BOX = np.array([[1.0, 2.0, 0.75, 4.0, 2.0, 1.5, 0.0]])


def test_boxes_and_headings_have_their_edges_and_dashes():
    turned = BOX + np.array([0, 0, 0, 0, 0, 0, np.pi / 2])
    np.testing.assert_allclose(box_lines.headings(turned), [[[1, 2, 1.5], [1, 4, 1.5]]], atol=1e-12)
    assert box_lines.headings(np.zeros((0, 7))).shape == (0, 2, 3)
    edges = box_lines.box_edges(BOX)
    lengths = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    assert sorted(lengths.round(6)) == [1.5] * 4 + [2.0] * 4 + [4.0] * 4
    assert len(box_lines.EDGES) == 12
    cross = box_lines.roof_crosses(BOX)
    np.testing.assert_allclose(cross[..., 2], 1.5)
    np.testing.assert_allclose(np.linalg.norm(cross[:, 1] - cross[:, 0], axis=1), np.sqrt(20))
    mast = box_lines.spikes(BOX)
    np.testing.assert_allclose(mast[0], [[1, 2, 1.5], [1, 2, 4.0]])
    assert mast.shape == (3, 2, 3)
    none = np.zeros((0, 7))
    assert [
        len(make(none)) for make in (box_lines.box_edges, box_lines.roof_crosses, box_lines.spikes)
    ] == [0, 0, 0]
    assert box_lines.dashes(np.zeros((0, 2, 3)), dash=1.0, gap=1.0).shape == (0, 2, 3)
    made = box_lines.dashes(np.array([[[0.0, 0, 0], [0, 10, 0]]]), dash=1.0, gap=1.5)
    np.testing.assert_allclose(made[:, :, 1], [[0, 1], [2.5, 3.5], [5, 6], [7.5, 8.5]])
