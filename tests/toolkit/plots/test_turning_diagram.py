"""Turning-movement diagrams: written, reproducible, with every count and arm in them."""

import pytest
from matplotlib.text import Text

from toolkit.counting.counts import MovementCount
from toolkit.plots.turning_diagram import ArmBearing, draw_turning_diagram

ARMS = [ArmBearing("north", 2.0), ArmBearing("east", 95.0), ArmBearing("west", 270.0)]
MOVEMENTS = [
    MovementCount("vehicle", "west", "east", 312, 30.0, 9.0),
    MovementCount("heavy", "west", "east", 11, 30.0, 9.0),
    MovementCount("vehicle", "north", "west", 47, 22.0, 12.0),
    MovementCount("pedestrian", "east", "east", 5, 5.0, 50.0),
]


@pytest.fixture
def texts(spy):
    """Texts of the picture that was drawn last."""
    calls = spy("toolkit.plots.turning_diagram", "write_figure")
    return lambda: {text.get_text() for text in calls[-1].args[0].findobj(Text)}


@pytest.mark.one_in(2)
@pytest.mark.parametrize("ending", ["png", "svg"])
def test_counts_and_arms_are_in_the_picture(tmp_path, texts, ending):
    out = tmp_path / f"counts.{ending}"
    draw_turning_diagram(MOVEMENTS, ARMS, out, title="Elm Street", subtitle="60 minutes")
    first = out.read_bytes()
    assert {"323", "47", "5", "370 vehicles", "5 pedestrians", "Elm Street"} <= texts()
    assert {"in 323\nout 47", "in 47\nout 0", "in 0\nout 323", "north"} <= texts()
    draw_turning_diagram(MOVEMENTS, ARMS, out, title="Elm Street", subtitle="60 minutes")
    assert out.read_bytes() == first


def test_a_street_without_road_users_has_arms_only(tmp_path, texts):
    draw_turning_diagram([], ARMS, tmp_path / "none.png", title="night")
    assert "0 vehicles" in texts()
    with pytest.raises(ValueError, match=r"must end in \.png or \.svg"):
        draw_turning_diagram([], ARMS, tmp_path / "none.gif", title="night")
