"""Names in the live scene: short ones in every browser, long ones not on a telephone."""

from types import SimpleNamespace

import numpy as np

from coview.live_names import LONG_NAMES_NODE, add_long_names, add_name, hide_long_names

TOP = np.array([1.0, 2.0, 3.0])
LONG = "northern-approach-lamp-02-of-the-market-street"


class Scene:
    """Scene that keeps the labels and groups that are added, by name."""

    def __init__(self):
        self.texts, self.visible = {}, {}

    def add_label(self, name, text, **options):
        self.texts[name] = text
        return SimpleNamespace(name=name, text=text, **options)

    def add_frame(self, name, *, show_axes, visible):
        assert not show_axes
        self.visible[name] = visible


def test_long_names_share_a_node():
    drawn = Scene()
    assert add_name(drawn, "/a/label", "pole07", TOP, scale=1.2).name == "/a/label"
    label = add_name(drawn, "/b/label", LONG, TOP, scale=0.7)
    assert label.name == f"{LONG_NAMES_NODE}/b/label"
    assert drawn.texts == {"/a/label": "pole07", f"{LONG_NAMES_NODE}/b/label": LONG}
    np.testing.assert_array_equal(label.position, TOP)
    assert (label.font_screen_scale, label.anchor) == (0.7, "bottom-center")


def test_one_browser_hides_the_long_names():
    drawn, client = Scene(), SimpleNamespace(scene=Scene())
    add_long_names(drawn)
    hide_long_names(client)
    assert drawn.visible == {LONG_NAMES_NODE: True}
    assert client.scene.visible == {LONG_NAMES_NODE: False}
