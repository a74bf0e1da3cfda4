"""Properties of poles in other people's words."""

import pytest

from placement_env.candidates.pole_properties import not_understood, property_meant


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("Height", "height"),
        ("HEIGHT_M", "height"),
        ("pole height [m]", "height"),
        ("heigth", "height"),
        ("Höhe", "height"),
        ("minHeight", "min_height"),
        ("Max. height", "max_height"),
        ("cost_eur", "price"),
        ("Preis", "price"),
        ("Price", "price"),
        ("capacity_mbit", "capacity_kbit"),
        ("Capacity", "capacity_kbit"),
        ("linkKbit", "capacity_kbit"),
        ("Name", "name"),
        ("keepout", "keep_out"),
        ("Keep_Out", "keep_out"),
        ("keep-out", "keep_out"),
        ("owner", None),
        ("fid", None),
        ("", None),
        ("2024", None),
    ],
)
def test_what_was_meant(key, meant):
    assert property_meant(key) == meant


def test_each_is_named_once_and_known_ones_are_not():
    known = {"name": 1, "height": 2, "max_height": 3, "min_height": 4, "price": 5, "capacity_kbit": 6, "capacity": 7}
    assert not_understood([known | {"keep_out": True, "kind": "x", "layer": "mount", "used": False}]) == ""
    assert not_understood([]) == ""
    poles = [{"Price": 1, "fid": 3}, {"fid": 4, "Price": 2}, {"colour": "red"}]
    assert not_understood(poles) == "Price: price (1: that of an ordinary pole)?, fid, colour"


def test_of_areas_only_what_may_keep_sensors_out():
    areas = [{"building": "yes", "Height": 9, "KeepOut": True}]
    assert not_understood(areas, areas=True) == "KeepOut: keep_out (true or false, of a polygon)?"


def test_long_names_are_cut():
    assert len(not_understood([{"x" * 500: 1}])) == 60
