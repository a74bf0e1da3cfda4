"""From a map of one's own to an evaluation: every tool says the same of the same set.

Maps are drawn here, so that no junction of this test is anywhere else. `pytest -s -m slow
tests/coview/test_chain.py` prints the table of what each tool says at three junctions."""

import csv
import json
import math
from dataclasses import dataclass

import h5py
import numpy as np
import pytest

from coview.main import run as run_line
from placement_env import LivePlanner
from placement_env.candidates.candidates import aims
from placement_env.live.project import export_variant, report_variant
from toolkit.sites.files import load_site
from toolkit.sites.georeference import bearing_deg, inverse_project

CATALOGUE = """currency = "EUR"
pole_price = 1250
[[sensor]]
name = "Eye 120"
model = "DepthCamera"
price = 1500
width = 120
height = 90
"""
POLE_SPOTS = ((9.0, 8.0), (-9.0, 8.0), (-9.0, -8.5), (9.5, -8.0))  # m from the middle


@dataclass(frozen=True)
class Junction:
    """A junction to draw: its kind of map, bearings of its arms, and how its area is turned."""

    name: str
    kind: str
    arms: tuple[float, ...]
    bearing: float
    centre: tuple[float, float] = (11.3, 47.2)


SKEW = Junction("skew crossing", "osm", (20.0, 95.0, 200.0, 275.0), 90.0)
FORK = Junction("fork", "osm", (350.0, 110.0, 230.0), 63.5, (-3.7, 40.4))
BEND = Junction("bend", "opendrive", (), 90.0, (40.0, 0.0))


def draw_map(junction, folder):
    return draw_bend(folder) if junction.kind == "opendrive" else draw_arms(junction, folder)


def draw_arms(junction, folder):
    """OpenStreetMap file of named streets that meet in one node."""
    bearings = np.deg2rad(junction.arms)
    ends = 120.0 * np.column_stack([np.sin(bearings), np.cos(bearings)])
    places = inverse_project(np.concatenate([[[0.0, 0.0]], ends]), junction.centre)
    low, high = places.min(axis=0) - 1e-4, places.max(axis=0) + 1e-4
    lines = ['<osm version="0.6" generator="test">']
    lines.append(
        f'<bounds minlon="{low[0]}" minlat="{low[1]}" maxlon="{high[0]}" maxlat="{high[1]}"/>'
    )
    lines += [
        f'<node id="{k + 1}" lon="{x:.9f}" lat="{y:.9f}"/>'
        for k, (x, y) in enumerate(places.tolist())
    ]
    for k in range(len(ends)):
        tags = {"highway": "tertiary", "name": f"Strasse {k + 1}", "lanes": "2", "maxspeed": "50"}
        text = "".join(f'<tag k="{key}" v="{value}"/>' for key, value in tags.items())
        lines.append(f'<way id="{100 + k}"><nd ref="1"/><nd ref="{k + 2}"/>{text}</way>')
    path = folder / "map.osm"
    path.write_text("\n".join([*lines, "</osm>"]))
    return path


def draw_bend(folder):
    """OpenDRIVE file of a street that turns by 60 degrees."""
    lane = '<lane id="{}" type="{}"><width sOffset="0" a="{}" b="0" c="0" d="0"/></lane>'
    left = lane.format(2, "sidewalk", 2) + lane.format(1, "driving", 3.5)
    right = lane.format(-1, "driving", 3.5) + lane.format(-2, "sidewalk", 2)
    radius, arc = 40.0, 40.0 * math.pi / 3
    x, y = 20 + radius * math.sin(math.pi / 3), radius * (1 - math.cos(math.pi / 3))
    pieces = (
        ('s="0" x="-80" y="0" hdg="0" length="100"', "<line/>"),
        (f's="100" x="20" y="0" hdg="0" length="{arc}"', f'<arc curvature="{1 / radius}"/>'),
        (f's="{100 + arc}" x="{x}" y="{y}" hdg="{math.pi / 3}" length="90"', "<line/>"),
    )
    plan = "".join(f"<geometry {where}>{shape}</geometry>" for where, shape in pieces)
    path = folder / "map.xodr"
    path.write_text(
        '<OpenDRIVE><header revMajor="1" revMinor="4" north="200" south="-60" east="200" west="-90"/>'
        f'<road name="Bend" length="{190 + arc}" id="1" junction="-1"><planView>{plan}</planView>'
        '<elevationProfile/><lanes><laneSection s="0">'
        f'<left>{left}</left><center><lane id="0" type="none"/></center><right>{right}</right>'
        "</laneSection></lanes></road></OpenDRIVE>"
    )
    return path


def draw_poles(site, path):
    """Poles with prices, heights and links of their own, in the site's metres."""
    features = []
    for k, spot in enumerate(POLE_SPOTS):
        properties = {
            "name": f"LSA {k + 3}",
            "price": 1000 + 125 * k,
            "height": 6.5,
            "capacity_kbit": 1800 + k,
        }
        features.append(
            {
                "type": "Feature",
                "properties": properties,
                "geometry": {"type": "Point", "coordinates": spot},
            }
        )
    path.write_text(
        json.dumps({"type": "FeatureCollection", "coview_site": 1, "features": features})
    )
    return path


def coview(*words):
    code = run_line([str(word) for word in words])
    assert code == 0, words


class Chain:
    """One junction's way through the tools, each answer kept."""

    def __init__(self, junction, folder, *, sensors, frames):
        self.junction, self.folder = junction, folder
        self.sensors, self.frames = sensors, frames
        self.cache = ("--cache", folder / "cache")

    def plan(self):
        junction, folder = self.junction, self.folder
        site = folder / "site.json"
        where = (
            "--centre",
            *junction.centre,
            "--size",
            60,
            44,
            "--bearing",
            junction.bearing,
            "--furnish",
            "none",
        )
        coview(
            "site",
            "import",
            f"--{junction.kind}",
            draw_map(junction, folder),
            *where,
            "--out",
            site,
        )
        (folder / "sensors.toml").write_text(CATALOGUE)
        stock = (
            "--candidates",
            draw_poles(site, folder / "poles.geojson"),
            "--sensors",
            folder / "sensors.toml",
        )
        asked = (
            "--budget",
            self.sensors,
            "--money",
            8000,
            "--iou",
            0.5,
            "--frames",
            self.frames,
            "--workers",
            1,
        )
        coview("plan", site, *stock, *asked, *self.cache, "--out", folder / "plan")
        made = json.loads((folder / "plan/plan.json").read_text())
        sensors = [
            describe(s, s["bearing_deg"], s["tilt_deg"], s["height"]) for s in made["sensors"]
        ]
        chosen = made["chosen"]
        figures = {
            "price": chosen["price"],
            "AP": chosen["judged"]["ap"],
            "predicted": chosen["predicted"],
        }
        return {
            "sensors": sensors,
            "money": made["question"]["money"],
            "currency": made["currency"],
            **figures,
        }

    def read_schedule(self, path):
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        sensors = []
        for row in rows:
            named = {"name": row["sensor"], "pole": row["pole"], "model": row["model"]}
            named |= {key: float(row[key]) for key in ("model_price", "pole_price")}
            sensors.append(
                describe(
                    named, *(float(row[key]) for key in ("bearing_deg", "tilt_deg", "height_m"))
                )
            )
        price = sum(float(row["model_price"]) + float(row["pole_price"]) for row in rows)
        return {"sensors": sensors, "price": price, "currency": rows[0]["price_unit"]}

    def what_if(self, capsys):
        schedule = self.read_schedule(self.folder / "plan/schedule.csv")
        changes = []
        for name, _, _, bearing, tilt, height, *_ in schedule["sensors"]:
            changes += ["--move", name, bearing, tilt, "--lift", name, height]
        capsys.readouterr()
        coview("what-if", self.folder / "plan", *changes, *self.cache, "--json")
        found = json.loads(capsys.readouterr().out)
        before, after = found["before"], found["after"]
        assert after["change"] == 0.0
        for name in ("ap", "worst", "recall", "kbit", "price", "links", "approaches", "classes"):
            assert after[name] == before[name], name
        figures = {
            "price": before["price"],
            "AP": before["stated"]["ap"],
            "predicted": before["ap"],
        }
        return {"money": before["budget"], "currency": before["currency"], **figures}

    def open_live(self):
        planner = LivePlanner(self.folder / "plan")
        answer = planner.finish()
        export_variant(planner, self.folder / "export")
        exported = self.read_schedule(self.folder / "export/schedule.csv")
        figures = {"AP": planner.stated.ap, "predicted": answer.ap, "money": answer.budget}
        assert exported["price"] == answer.price
        report_variant(planner, self.folder / "report")
        return exported | figures

    def read_report(self):
        made = json.loads((self.folder / "report/plan.json").read_text())
        sensors = [
            describe(s, s["bearing_deg"], s["tilt_deg"], s["height"]) for s in made["sensors"]
        ]
        chosen = made["chosen"]
        figures = {
            "price": chosen["price"],
            "AP": chosen["judged"]["ap"],
            "currency": made["currency"],
        }
        return {"sensors": sensors, "money": made["question"]["money"], **figures}

    def simulate(self):
        recording, site = self.folder / "r.hdf5", load_site(self.folder / "export/site.json")
        coview(
            "simulate",
            self.folder / "export/site.json",
            "--frames",
            2,
            "--workers",
            1,
            "--out",
            recording,
        )
        with h5py.File(recording) as file:
            names = json.loads(str(file["coview"].attrs["sensors"]))
        headings, tilts = aims(site.sensors)
        bearings = [round(bearing_deg(site, heading), 1) % 360 for heading in headings.tolist()]
        coview(
            "evaluate",
            recording,
            "--detector",
            "general",
            "--frames",
            2,
            "--out",
            self.folder / "scores",
        )
        table = json.loads((self.folder / "scores/table.json").read_text())
        assert table
        rows = zip(names, bearings, np.rad2deg(tilts).round(1).tolist(), strict=True)
        return {"directions": [(name, bearing, tilt) for name, bearing, tilt in rows]}


def describe(sensor, bearing, tilt, height):
    """Name, pole, model, direction, height and prices of a sensor as tools print them."""
    direction = round(bearing, 1) % 360, round(tilt, 1) + 0.0, round(height, 3)
    return (
        sensor["name"],
        sensor["pole"],
        sensor["model"],
        *direction,
        sensor["model_price"],
        sensor["pole_price"],
    )


def follow(junction, folder, capsys, **amounts):
    """Follow the chain, and return what each tool says."""
    chain = Chain(junction, folder, **amounts)
    said = {"plan": chain.plan()}
    said["schedule"] = chain.read_schedule(folder / "plan/schedule.csv")
    said["what-if"] = chain.what_if(capsys)
    said["live"] = chain.open_live()
    said["variant's report"] = chain.read_report()
    said["recording"] = chain.simulate()
    return said


def check_agreement(said):
    """Compare what tools say with the plan, and the directions with those of the recording."""
    plan = said["plan"]
    for tool, figures in said.items():
        for name, figure in figures.items():
            if name == "directions":
                assert figure == [(row[0], row[3], row[4]) for row in plan["sensors"]], tool
            elif isinstance(figure, float):
                assert figure == pytest.approx(plan[name], abs=1e-6), (tool, name)
            else:
                assert figure == plan[name], (tool, name)


def tabulate(name, said):
    """Rows of the table: what each tool says of each figure, and whether all agree."""
    names = ("AP", "predicted", "price", "currency", "money")
    rows = [
        f"| {name}: {figure} | {' | '.join(str(each.get(figure, '')) for each in said.values())} |"
        for figure in names
    ]
    for k, sensor in enumerate(said["plan"]["sensors"]):
        cells = []
        for each in said.values():
            shown = each["sensors"][k] if "sensors" in each else each.get("directions", [()] * 9)[k]
            cells.append(", ".join(str(value) for value in shown[1:]))
        rows.append(f"| {name}: {sensor[0]} | {' | '.join(cells)} |")
    return rows


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_every_tool_says_the_same_of_the_same_set(tmp_path, capsys):
    said = follow(FORK, tmp_path, capsys, sensors=1, frames=1)
    check_agreement(said)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_every_tool_says_the_same_at_three_junctions(tmp_path, capsys):
    lines = []
    for junction in (SKEW, FORK, BEND):
        folder = tmp_path / junction.name.replace(" ", "-")
        folder.mkdir()
        said = follow(junction, folder, capsys, sensors=3, frames=6)
        check_agreement(said)
        if not lines:
            lines = [f"| | {' | '.join(said)} |", "|---" * (1 + len(said)) + "|"]
        lines += tabulate(junction.name, said)
    with capsys.disabled():
        print("", *lines, sep="\n")
