"""SUMO networks made by netconvert, and the road polygons in them."""

import os
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest
import shapely

from toolkit.sites import network
from toolkit.sites.network import (
    build_network,
    cut_polygons,
    list_polygons,
    netconvert,
    road_polygons,
    run_netconvert,
    street,
)


def cross() -> str:
    nodes = [
        {"id": i, "x": x, "y": y}
        for i, x, y in (("w", -90, 0), ("o", 0, 0), ("e", 90, 0), ("n", 0, 90))
    ]
    lanes = street(2, width=3.0, footway=2.0)
    ways = [(a, b) for arm in "wen" for a, b in ((arm, "o"), ("o", arm))]
    return build_network(
        nodes, [{"id": a + b, "from": a, "to": b, "lanes": lanes} for a, b in ways]
    )


def test_networks_are_repeatable_and_keep_their_coordinates(union):
    pytest.importorskip("sumo")
    net = cross()
    assert net == cross()
    assert "<!--" not in net
    assert ElementTree.fromstring(net).find("location").get("netOffset") == "0.000,0.000"
    lanes, footways = road_polygons(net, (-40.0, -40.0, 40.0, 40.0), margin=0.0)
    assert union(lanes).intersection(
        shapely.LineString([(-30, -20), (-30, 20)])
    ).length == pytest.approx(12)
    assert union(footways).intersection(
        shapely.LineString([(-30, -20), (-30, 20)])
    ).length == pytest.approx(4)
    assert union([*lanes, *footways]).bounds == (-40, -8, 40, 40)
    assert all(shapely.Polygon(p).is_valid for p in (*lanes, *footways))


def test_what_netconvert_refuses_and_missing_sumo_are_told(without_packages, environment):
    pytest.importorskip("sumo")
    with pytest.raises(ValueError, match=r"^netconvert: .*nowhere") as refusal:
        build_network(
            [{"id": "a", "x": 0, "y": 0}],
            [{"id": "ab", "from": "a", "to": "nowhere", "lanes": street(1)}],
        )
    assert "\n" not in str(refusal.value)
    with pytest.raises(ValueError, match="netconvert"):
        run_netconvert(["--opendrive-files=/no/such/file.xodr"])
    without_packages("sumo")
    environment(PATH="", SUMO_HOME=None)
    with pytest.raises(ImportError, match=r"pip install coview\[sim\]"):
        netconvert()


@pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="other systems cannot tie a child to its parent"
)
def test_netconvert_has_limits_and_dies_with_its_parent(
    tmp_path, limits, without_packages, environment
):
    program, said = tmp_path / "netconvert", tmp_path / "said"
    program.write_text(
        f"#!/bin/sh\necho $$ $(ulimit -v) > {said}.new; mv {said}.new {said}; exec sleep 60\n"
    )
    program.chmod(0o755)
    without_packages("sumo")
    environment(PATH=f"{tmp_path}:{os.environ['PATH']}", SUMO_HOME=None)
    limits(network, MAX_RUN_S=1.0)
    with pytest.raises(ValueError, match="no network made in 1 s"):
        run_netconvert([])
    assert int(said.read_text().split()[1]) * 1024 == network.MAX_MEMORY_BYTES
    said.unlink()
    code = (
        f"from toolkit.sites import network; network.netconvert = lambda: {str(program)!r}; "
        "network.run_netconvert([])"
    )
    parent = subprocess.Popen([sys.executable, "-c", code])
    while not said.exists():
        time.sleep(0.02)
    parent.kill()
    parent.wait()
    child = Path("/proc", said.read_text().split()[0])
    for _ in range(100):
        if not child.exists() or ") Z " in (child / "stat").read_text():
            return
        time.sleep(0.05)
    pytest.fail("it lives on")


def test_polygons_within_collections_are_not_lost():
    squares = shapely.MultiPolygon([shapely.box(0, 0, 2, 2), shapely.box(5, 0, 7, 2)])
    mixed = shapely.GeometryCollection(
        [shapely.LineString([(0, 0), (9, 9)]), squares, shapely.box(8, 0, 9, 2)]
    )
    assert [part.area for part in list_polygons(mixed)] == [4, 4, 2]
    assert (
        sum(shapely.Polygon(p).area for p in cut_polygons([mixed], shapely.box(1, 0, 20, 20))) == 8
    )
