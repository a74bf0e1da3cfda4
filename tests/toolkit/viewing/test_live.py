import time
import urllib.request
from contextlib import suppress
from dataclasses import replace

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from toolkit.datasets.listing import Listing
from toolkit.datasets.recording_views import Part
from toolkit.viewing import drawing, live_view, scene
from toolkit.viewing.live_view import LiveView, view_live


@pytest.fixture
def recording(samples):
    """Two samples, and one that is damaged."""

    def load(name):
        if name == "2":
            raise ValueError("labels.json is *damaged*")
        return replace(samples[int(name)])

    return Part(Listing(("0", "1", "2"), load))


@pytest.fixture
def view(recording, finds_the_car):
    with scene.viser_server() as server:
        yield LiveView(server, recording, drawing.Drawing(finds_the_car))


def shown(view):
    return {handle.name for handle in view.shown}


FIRST = {
    *("/sensors/0/place/0", "/sensors/0/sensor/0", "/ignored/vehicle/0", "/tags/vehicle/0-0"),
    *(f"/truth/{kind}/0" for kind in ("vehicle", "pedestrian", "others")),
}


def test_the_first_sample_is_shown_and_described(view):
    assert view.status_text == (
        "first: 400 points, 3 labelled (0 hit, 0 missed, 3 not counted), 1 detected (0 hits, 0 "
        "false alarms, 1 ignored)"
    )
    assert shown(view) == FIRST
    assert set(view.groups) >= {"/grid", "/sensors/0", "/truth/heavy", "/detections/others"}


def test_the_next_sample_takes_the_place_of_the_first(view):
    view.show(1)
    assert view.status_text.startswith("second: 500 points")
    assert {"/sensors/1/place/0", "/sensors/1/sensor/0"} < shown(view)
    assert "/truth/pedestrian/0" not in shown(view)
    assert view.style.sensors == ("north", "south")
    view.show(0)
    assert shown(view) == FIRST


def test_a_damaged_sample_is_said_and_shows_nothing(view):
    view.show(2)
    assert view.status_text == "sample 2 cannot be shown: labels.json is *damaged*"
    assert view._status_line.content.endswith(r"labels\.json is \*damaged\*")
    assert shown(view) == set()
    view.show(0)
    assert shown(view) == FIRST


def test_colours_change_what_is_shown(view):
    view.colour_by("height")
    assert "/sensors/0/height/0" in shown(view)
    assert "/sensors/0/sensor/0" not in shown(view)
    view.show(1)
    assert {"/sensors/0/height/0", "/sensors/1/height/0"} < shown(view)
    assert [view.groups[f"/sensors/1/{each}"].visible for each in ("sensor", "height")] == [
        False,
        True,
    ]


def wait_until(true):
    """Controls act in threads of viser."""
    for _ in range(200):
        if true():
            return
        time.sleep(0.05)
    pytest.fail("nothing happened in 10 s")


def test_switches_hide_and_the_slider_goes_to_a_frame(view):
    view.switches["north"].value = False
    wait_until(lambda: not view.groups["/sensors/0"].visible)
    view.switches["vehicle"].value = False
    wait_until(
        lambda: (
            not view.groups["/truth/vehicle"].visible
            and not view.groups["/detections/vehicle"].visible
        )
    )
    assert view.groups["/truth/pedestrian"].visible
    assert view.groups["/truth"].visible
    assert not view.groups["/missed/vehicle"].visible
    view.switches["missed, red with a cross"].value = False
    wait_until(lambda: not view.groups["/missed"].visible)
    assert view.groups["/hits"].visible
    view.switches["north"].value = True
    wait_until(lambda: view.groups["/sensors/0"].visible)
    view.switches["frame"].value = 1
    wait_until(
        lambda: view.status_text.startswith("second") and "/sensors/1/sensor/0" in shown(view)
    )
    assert "south" in view.switches


@pytest.mark.parametrize("port", [0, -1, 65536])
def test_a_port_that_is_none_is_refused(recording, port):
    with pytest.raises(ValueError, match=r"port must lie in 1\.\.65535"):
        view_live(recording, drawing.Drawing(), port=port)


def test_a_first_sample_that_is_damaged_is_an_error(recording):
    damaged = Part(Listing(("2",), recording.recording.load))
    with scene.viser_server() as server, pytest.raises(ValueError, match="damaged"):
        LiveView(server, damaged, drawing.Drawing())
    with scene.viser_server() as server:
        switches = LiveView(server, recording, drawing.Drawing()).switches
    assert not [name for name in switches if name.startswith(("hits", "missed", "false"))]


def test_large_clouds_are_said_to_be_thinned(view, limits):
    limits(live_view, LIVE_POINTS=300)
    view.show(0)
    assert view.status_text.endswith("of larger clouds 300 points are drawn")


def test_it_is_served_until_it_is_interrupted(recording, monkeypatch):
    said = []

    def interrupted(self):
        port, address = self.get_port(), addresses[0]
        said.append(urllib.request.urlopen(address).status)
        local, path = f"http://127.0.0.1:{port}", address.removeprefix(f"http://127.0.0.1:{port}")
        for origin, at in (
            (local, path),
            ("http://evil.example", path),
            (None, path),
            (local, "/"),
            (local, "/x/"),
        ):
            with suppress(InvalidStatus), connect(f"ws://127.0.0.1:{port}{at}", origin=origin):
                said.append((origin, at))
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(local)
        assert said == [200, (local, path)]
        raise KeyboardInterrupt

    monkeypatch.setattr("viser.ViserServer.sleep_forever", interrupted)
    addresses = []
    view_live(recording, drawing.Drawing(), port=18765, ready=addresses.append)
    (address,) = addresses
    assert address.startswith("http://127.0.0.1:187")
