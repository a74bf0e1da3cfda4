"""A small plan as `make_plan` gives it: four sensors at the T-junction, three frames."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from placement_env.handover.ground import GroundGrid, GroundShares
from placement_env.handover.mounted import MaterialItem, PlannedSensor, PoleLoad
from placement_env.report import content
from placement_env.report.motion_content import (
    CountedGroup,
    FollowedClass,
    MotionFigures,
    RoadUserFigure,
)
from placement_env.report.pages.report import build_document
from toolkit.counting.counts import CountError
from toolkit.objects import Detections, Objects
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site

CHOSEN = ("d0", "d1", "d3", "d5")
HOSTILE = '<script>document.title="owned"</script>#eval("1") $x^2$ `raw` \\ @ref'


def judged(ap, half=0.03, vehicles=412):
    return content.Judgement(
        ap, max(ap - half, 0.0), min(ap + half, 1.0), min(ap + 0.01, 1.0), 0.97, vehicles, 60
    )


def example_motion():
    """Vehicles that are followed well, and pedestrians half of whom are never detected."""
    vehicles = FollowedClass(
        label="vehicle",
        road_users=6,
        mostly_tracked=RoadUserFigure(5 / 6, 0.4365, 0.9699),
        entering=4,
        first_detection_s=RoadUserFigure(0.3, 0.0, np.inf),
        first_detection_95_s=RoadUserFigure(1.2, 0.3, np.inf),
        never_detected=RoadUserFigure(0.0, 0.0, 0.4899),
        speed_error_km_h=RoadUserFigure(0.84),
    )
    pedestrians = FollowedClass(
        label="pedestrian",
        road_users=12,
        mostly_tracked=RoadUserFigure(0.5, 0.2538, 0.7462),
        entering=3,
        first_detection_s=RoadUserFigure(np.inf, 0.4, np.inf),
        first_detection_95_s=RoadUserFigure(np.inf, np.inf, np.inf),
        never_detected=RoadUserFigure(2 / 3, 0.2077, 0.9385),
        speed_error_km_h=RoadUserFigure(0.5, 0.4, 0.6),
    )
    vehicle_trips = CountedGroup(
        group="vehicles",
        count=3,
        true_count=4,
        error=-1,
        found=RoadUserFigure(0.75, 0.3006, 0.9544),
        right=RoadUserFigure(1.0, 0.4385, 1.0),
        speed_error_km_h=RoadUserFigure(-0.24),
    )
    no_trips = CountedGroup("pedestrians", 0, 0, 0, *[RoadUserFigure(np.nan, 0.0, 1.0)] * 3)
    return MotionFigures(
        refusal="",
        seed=3000009,
        frames=150,
        interval_s=0.1,
        traffic_sha256="5b" * 32,
        errors="paper",
        classes=(vehicles, pedestrians),
        counts=(vehicle_trips, no_trips),
        movements=(CountError("vehicle", "north", "south", 3, 4, 21.0, 21.2, 9.1, 9.0),),
    )


def example_plan(site, ground):
    sensors = tuple(
        PlannedSensor(
            name=s.name,
            pole=f"post0{i}",
            x=float(s.position[0]),
            y=float(s.position[1]),
            z=float(s.position[2]),
            longitude=14.4235 + i * 1e-4,
            latitude=50.0812,
            height=5.2,
            bearing_deg=45.0 + 80 * i,
            tilt_deg=20.0,
            model="depth camera",
            model_price=0.5,
            pole_price=1.0,
            kbit=310.5 + i,
            peak_kbit=402.0 + i,
            capacity_kbit=2000.0,
            load_kbit=390.0 + i,
        )
        for i, s in enumerate(s for s in site.sensors if s.name in CHOSEN)
    )

    def option(names, price, kbit, ap):
        return content.PlanOption(
            names, price, kbit, kbit * len(names), ap, judged(ap), ("greedy", "cpsat")
        )

    options = (
        *(option(("d3",), 1.5, 300.0, 0.71), option(("d0", "d3"), 3.0, 310.0, 0.88)),
        *(option(CHOSEN[:3], 4.5, 312.0, 0.934), option(CHOSEN, 6.0, 312.0, 0.962)),
    )
    near = option(("d0", "d2", "d3", "d5"), 6.0, 309.0, 0.951)
    worth = tuple(
        content.SensorWorth(
            name, value, {other: round(0.02 - 0.01 * i, 3) for other in CHOSEN if other != name}
        )
        for i, (name, value) in enumerate(zip(CHOSEN, (0.18, 0.21, 0.41, 0.16), strict=True))
    )
    left = {
        ("d0",): 0.91,
        ("d1",): 0.93,
        ("d3",): 0.78,
        ("d5",): 0.934,
        ("d0", "d3"): 0.52,
        ("d1", "d5"): 0.88,
    }
    failures = tuple(content.FailureCase(failed, judged(ap)) for failed, ap in left.items())
    open_cells = ground.open_ground
    count = ground.seen.sum(0)[open_cells]
    shares = tuple(float((count >= k).mean()) for k in (1, 2, 3))
    return content.Plan(
        question={
            "site": site.name,
            "budget": 6.0,
            "min_ap": 0.95,
            "max_kbit": None,
            "scheme": "late",
            "seed": 0,
        },
        site=site.name,
        detector="VoxelNet, trained at tjunction",
        iou=0.7,
        scheme="late",
        currency="EUR",
        verdict=content.Verdict(
            True, "Yes: 4 sensors for 6 EUR reach AP 0.962, and 0.95 was asked for."
        ),
        chosen=options[-1],
        why=("No set within 6 EUR has a higher AP.", "It is the cheapest that reaches 0.95."),
        sensors=sensors,
        considered=(*options, near),
        near_optimal=(near,),
        front=options,
        schemes=tuple(
            content.SchemeFigures(scheme, 0.7, judged(ap), kbit)
            for scheme, ap, kbit in (
                ("early", 0.97, 1480.0),
                ("late", 0.962, 312.0),
                ("hybrid", 0.968, 610.0),
            )
        ),
        by_zone=(
            content.BreakdownRow("middle of the junction", judged(0.99), 812.0),
            content.BreakdownRow("west arm", judged(0.91)),
        ),
        by_range=(
            *(
                content.BreakdownRow("0–15 m", judged(0.98)),
                content.BreakdownRow("15–30 m", judged(0.95)),
            ),
            content.BreakdownRow(">30 m", None),
        ),
        by_approach=(
            content.BreakdownRow("from the west", judged(0.95)),
            content.BreakdownRow("from the east", judged(0.97)),
        ),
        by_class=(
            *(
                content.ClassSeen("vehicle", 412, 10, 0.98),
                content.ClassSeen("cyclist", 61, 10, 0.83),
            ),
            content.ClassSeen("heavy", 0, 10, None),
        ),
        motion=example_motion(),
        worth=worth,
        failures=failures,
        links=tuple(
            PoleLoad(
                *(s.pole, 3.12, 4.02, 20.0 if i else 3.0, 0.195 if i else 1.3, bool(i), 3.9),
                packets_s=10.0,
                airtime_ms_s=12.5,
            )
            for i, s in enumerate(sensors)
        ),
        materials=(
            MaterialItem("depth camera", 4, 0.5, 2.0),
            MaterialItem("pole with power and link", 4, 1.0, 4.0),
        ),
        order=tuple(
            content.BuildStep(name, 1.5 * (i + 1), judged(ap))
            for i, (name, ap) in enumerate(
                zip(("d3", "d0", "d1", "d5"), (0.71, 0.88, 0.934, 0.962), strict=True)
            )
        ),
        ground=GroundShares(
            shares, 1 - shares[0], 0.04, {s.name: 900 + i for i, s in enumerate(sensors)}, 2950, 181
        ),
        poles_unused=("post07", "post11"),
        assumptions=("Traffic is simulated.", "Sensors hang still."),
        unknown=("How rain changes the figures.",),
        provenance={
            "versions": {"coview": "0.1.0"},
            "seeds": {"search": 0, "judgement": 7},
            "site": "9f2c" * 8,
        },
    )


def example_ground(site, names):
    x, y = np.arange(-39.5, 40), np.arange(-19.5, 20)
    grid = np.stack(np.meshgrid(x, y), -1)
    solids = shapely.union_all(
        [shapely.Polygon(s.footprint) for s in site.solids if s.kind != "tree"]
    )
    open_ground = ~shapely.contains_xy(solids, grid[..., 0], grid[..., 1])
    lanes = shapely.contains_xy(
        shapely.union_all([shapely.Polygon(p) for p in site.lanes]), grid[..., 0], grid[..., 1]
    )
    seen, density = [], []
    for sensor in (s for s in site.sensors if s.name in names):
        away = grid - sensor.position[:2]
        distance = np.linalg.norm(away, axis=-1)
        forward = sensor.world_SE3_body[:2, 0]
        inside = (
            (away @ forward > 0.72 * np.linalg.norm(forward) * distance)
            & (distance < 40)
            & open_ground
        )
        seen.append(inside)
        density.append(np.where(inside, 4000 / np.maximum(distance, 4) ** 2, 0).astype(np.float32))
    return GroundGrid(
        x,
        y,
        np.array(seen),
        np.array(density),
        open_ground,
        lanes & open_ground,
        np.zeros_like(lanes),
    )


def hostile(example):
    """The example with names that would be markup or code if not escaped."""
    sensors = tuple(replace(sensor, name=sensor.name + HOSTILE) for sensor in example.plan.sensors)
    mounted = tuple(
        Sensor(sensor.name + HOSTILE, sensor.model, sensor.pose) for sensor in example.site.sensors
    )
    chosen = replace(example.plan.chosen, sensors=tuple(sensor.name for sensor in sensors))
    verdict = content.Verdict(True, HOSTILE, (HOSTILE,))
    plan = replace(
        example.plan,
        sensors=sensors,
        chosen=chosen,
        verdict=verdict,
        site=HOSTILE,
        question={HOSTILE: HOSTILE},
    )
    return replace(example, plan=plan, site=replace(example.site, sensors=mounted))


def example_moment(ground, frame, count=900):
    rng = np.random.default_rng(frame)
    clouds = []
    for seen in ground.seen:
        rows, columns = np.nonzero(seen)
        pick = rng.integers(0, len(rows), count)
        xy = np.stack([ground.x[columns[pick]], ground.y[rows[pick]]], 1) + rng.uniform(
            -0.5, 0.5, (count, 2)
        )
        clouds.append(np.column_stack([xy, rng.uniform(0, 0.1, count)]).astype(np.float32))
    boxes = np.array(
        [
            [-20 + 4 * frame, 1.5, 0.8, 4.4, 1.8, 1.6, 0],
            [12 - 4 * frame, -2, 0.8, 4.6, 1.9, 1.6, np.pi],
        ]
    )
    boxes = np.concatenate([boxes, [[0, -14 + 3 * frame, 0.8, 4.5, 1.8, 1.6, np.pi / 2]]])
    found = np.concatenate(
        [boxes[:2] + np.array([0.1, 0, 0, 0, 0, 0, 0.02]), [[25.0, 8, 0.8, 4, 1.8, 1.5, 0.4]]]
    )
    return content.SceneMoment(
        tuple(clouds),
        Objects(boxes),
        Detections(found, np.array([0.9, 0.8, 0.4])),
        np.array([True, True, False]),
        np.zeros(3, bool),
        np.array([True, True, False]),
        np.zeros(3, bool),
    )


@pytest.fixture(scope="session")
def example():
    site = load_site("tjunction")
    ground = example_ground(site, CHOSEN)
    moments = tuple(example_moment(ground, frame) for frame in range(3))
    chosen = tuple(sensor for sensor in site.sensors if sensor.name in CHOSEN)
    return content.Planned(
        example_plan(site, ground), replace(site, sensors=chosen), ground=ground, moments=moments
    )


@pytest.fixture(scope="session")
def document(example):
    return build_document(example.plan, example.site, example.ground)


@pytest.fixture(scope="session")
def hostile_example(example):
    return hostile(replace(example, ground=None, moments=()))


@pytest.fixture(scope="session")
def nothing_chosen(example):
    plan = content.Plan(
        question={"site": "tjunction", "max_kbit": 0.001},
        site="tjunction",
        detector="VoxelNet",
        iou=0.7,
        scheme="late",
        currency="",
        verdict=content.Verdict(
            False, "No set meets the requirement.", ("No link carries 0.001 kbit per frame.",)
        ),
        chosen=None,
    )
    return content.Planned(plan, example.site)
