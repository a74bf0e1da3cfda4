import numpy as np
import pytest

from toolkit.mesh import box, merge
from toolkit.viewing import viser_scene
from toolkit.viewing.viser_scene import (
    add_lines,
    add_mesh,
    check_viser,
    overview,
    rgb,
    scene_html,
    start_at,
    viser_server,
)


def test_colours_by_their_hexadecimals():
    assert rgb("#0a10ff") == (10, 16, 255)


def test_the_server_is_for_this_machine_alone_and_ends(capsys):
    with viser_server() as server:
        assert server.get_host() == "127.0.0.1"
        add_mesh(server.scene, "/box", box((1, 1, 1)), "#112233")
        add_mesh(server.scene, "/nothing", merge([]), "#112233")
        assert add_lines(server.scene, "/none", np.zeros((0, 2, 3)), "#112233", width=1.0, visible=True) is None
        lines = add_lines(server.scene, "/line", np.ones((1, 2, 3)), "#112233", width=3.0, visible=False)
        assert (lines.name, lines.visible, lines.points.shape) == ("/line", False, (1, 2, 3))
        start_at(server, (0.0, -10.0, 5.0), (1.0, 2.0, 3.0))
        np.testing.assert_array_equal(server.initial_camera.look_at, [1, 2, 3])
        html = scene_html(server)
    assert html.index("scene: {ready: true}") < html.index("</head>")
    assert capsys.readouterr() == ("", "")


def test_the_camera_stands_south_of_the_middle_and_above_the_ground():
    position, look_at = overview((0.0, 0.0, 40.0, 20.0), height=2.0)
    assert look_at == (20.0, 10.0, 2.0)
    assert position == (14.0, -20.0, 28.0)


def test_without_viser_it_says_what_to_install(monkeypatch):
    monkeypatch.setattr(viser_scene, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"need viser: pip install coview\[report\]"):
        check_viser()
    with pytest.raises(ImportError, match=r"coview\[report\]"), viser_server():
        pytest.fail("never here")
