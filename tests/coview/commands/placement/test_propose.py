"""coview propose: an answer by the map alone."""

import json


def test_it_proposes_sensors_at_once(run):
    code, printed, err = run("propose", "tjunction", "--candidates", "paper", "--budget", 2, "--json")
    assert code == 0, err
    answer = json.loads(printed)
    assert len(answer["sensors"]) == 2
    assert 0.2 < answer["predicted_ap"] < 1
    assert answer["candidates"] == 6
    assert "random junctions" in answer["policy"]
    code, printed, _ = run("propose", "tjunction", "--candidates", "paper", "--budget", 2, "--no-look")
    assert code == 0
    assert printed.splitlines()[:-1] == answer["sensors"]
    assert "is predicted, not judged" in printed


def test_terms_are_kept(run):
    paper = ("propose", "tjunction", "--candidates", "paper", "--no-look")
    code, printed, _ = run(*paper, "--budget", 4, "--money", 2, "--json")
    assert (code, len(json.loads(printed)["sensors"])) == (0, 2)
    code, printed, _ = run(*paper, "--price", 9)
    assert code == 1
    assert "no candidate is worth it" in printed


CATALOGUE = """currency = "EUR"
pole_price = 4000
[[sensor]]
name = "camera"
model = "DepthCamera"
price = 1500
"""


def test_poles_that_carry_several_and_money_of_a_catalogue(run, tmp_path):
    """A pole of 4000 with two sensors of 1500; alone one of them costs 5500."""
    spot = {"type": "Point", "coordinates": [-12.0, -12.0]}
    properties = {"name": "pole", "max_sensors": 2, "capacity_kbit": 1e6}
    feature = {"type": "Feature", "properties": properties, "geometry": spot}
    poles, sensors = tmp_path / "poles.geojson", tmp_path / "sensors.toml"
    poles.write_text(json.dumps({"type": "FeatureCollection", "coview_site": 1, "features": [feature]}))
    sensors.write_text(CATALOGUE)
    asked = ("propose", "tjunction", "--candidates", poles, "--sensors", sensors, "--no-look", "--budget", 3, "--json")
    for money, count, price in ((5500, 1, 5500), (7000, 2, 7000), (99999, 2, 7000)):
        code, printed, err = run(*asked, "--money", money)
        assert code == 0, err
        answer = json.loads(printed)
        assert (len(answer["sensors"]), answer["price"], answer["currency"]) == (count, price, "EUR")
    assert run(*asked, "--money", 5499)[0] == 1


def test_wrong_arguments(refused, tmp_path):
    assert "--budget" in refused("propose", "tjunction", "--budget", 0)
    assert "--sensors" in refused("propose", "tjunction", "--candidates", "paper", "--sensors", tmp_path / "none.toml")
    assert "--money" in refused("propose", "tjunction", "--money", -1)
    assert "no policy at" in refused("propose", "tjunction", "--policy", tmp_path / "none")
    (tmp_path / "bad").write_bytes(b"damaged")
    assert "is damaged" in refused("propose", "tjunction", "--policy", tmp_path / "bad")
