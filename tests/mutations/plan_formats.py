"""Folders of plans and projects of the live planner: small sound ones, and what reads them."""

import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import shapely
from PIL import Image

from placement_env import LivePlanner
from placement_env.candidates.sensor_catalogue import (
    PricedModel,
    SensorCatalogue,
    load_sensor_catalogue,
)
from placement_env.cases import Cases
from placement_env.handover.exchange import SITE
from placement_env.handover.mounted import mounted_site
from placement_env.live.picture import keep_picture
from placement_env.live.project import ProjectFile
from placement_env.objective import Score
from placement_env.report.content import PLAN_VERSION
from placement_env.report.planning.plan_folder import PLAN_FILE, found_nothing, read_plan_folder
from placement_env.report.planning.plan_stock import format_stock
from placement_env.report.planning.question import Question, Stock
from placement_env.search.result import (
    Assessment,
    Certificate,
    Contender,
    History,
    ProfileAP,
    Result,
)
from placement_env.setting import Setting
from toolkit.runtime.reading import read_bytes
from toolkit.runtime.run import Run
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sites.files import load_site, save_site

EYE = PricedModel("eye", DepthCamera(width=120, height=90), 1500.0)
TURNING = PricedModel("turning", SpinningLidar(channels=16), 4000.0)
CATALOGUE = SensorCatalogue(
    (EYE, TURNING), "EUR", 900.0, "0" * 64, {"cable": 900.0, "power": 60.0}, 5.0
)
KEEP_OUT = (shapely.box(30.0, 10.0, 35.0, 15.0),)
CASES = Cases(iou=0.5, errors=("typical",))


def make_question(**options: object) -> Question:
    """Question of a plan that asks for nothing usual."""
    stock = Stock(catalogue=CATALOGUE, keep_out=KEEP_OUT, capacity_kbit=1234.0)
    setting = Setting(
        "tjunction",
        candidates=stock,
        scheme="late",
        classes=("vehicle", "pedestrian"),
        cases=CASES,
        most_price=9000.0,
    )
    return Question(setting, Run(seed=5, frames=3), sensors=3, **options)


def write_plan_folder(question: Question, members: list[int], folder: Path) -> dict[str, object]:
    """Write site.json and plan.json of a plan that nothing computed; return the content of
    plan.json."""
    candidates = question.setting.pool
    site = mounted_site(question.site, candidates, members)
    folder.mkdir(parents=True, exist_ok=True)
    save_site(site, folder / SITE)
    poles = [candidates.mounts[mount].name for mount in candidates.mount[members]]
    sensors = [
        {"name": sensor.name, "pole": pole}
        for sensor, pole in zip(site.sensors, poles, strict=True)
    ]
    judged = {"ap": 0.75, "low": None, "high": None, "vehicles": 70, "frames": 3}
    plan = {
        "coview_plan": PLAN_VERSION,
        "question": question.as_dict(),
        "verdict": {"met": None, "sentence": "A sentence."},
        "chosen": {"predicted": 0.7, "judged": judged},
        "sensors": sensors,
        "head": {"client": "City of Elm"},
        "stock": format_stock(question, candidates),
    }
    (folder / PLAN_FILE).write_text(json.dumps(plan, indent=1))
    return plan


@lru_cache
def _sound_site() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        write_plan_folder(make_question(), [3, 500], Path(folder))
        return (Path(folder) / SITE).read_bytes()


def make_plan(path: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        write_plan_folder(make_question(), [3, 500], Path(folder))
        path.write_bytes((Path(folder) / PLAN_FILE).read_bytes())


def read_plan(path: Path) -> None:
    found_nothing(path)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / SITE).write_bytes(_sound_site())
        (Path(folder) / PLAN_FILE).symlink_to(path)
        with said_of(path, folder):
            read_plan_folder(folder)


def make_plan_site(path: Path) -> None:
    path.write_bytes(_sound_site())


def read_plan_site(path: Path) -> None:
    """Read the folder of a sound plan with this site."""
    with tempfile.TemporaryDirectory() as folder:
        make_plan(Path(folder) / PLAN_FILE)
        (Path(folder) / SITE).symlink_to(path)
        with said_of(path, folder):
            read_plan_folder(folder)


@contextmanager
def said_of(path: Path, folder: str) -> Iterator[None]:
    """Let a refusal name the file's own folder in place of that of a copy."""
    try:
        yield
    except ValueError as error:
        raise ValueError(str(error).replace(folder, str(path.parent))) from None


@lru_cache
def _planner() -> LivePlanner:
    return LivePlanner("tjunction", frames=4)


def make_project(path: Path) -> None:
    """Write a project with two variants, a pole at free ground, an area, a picture and another
    question."""
    planner = _planner()
    planner.restore({"A": planner.yard.place(load_site("tjunction").sensors)}, "A", [])
    with tempfile.TemporaryDirectory() as folder:
        project = ProjectFile(Path(folder) / "a.live.json", planner)
        planner.move("d0", heading=1.0)
        planner.show("B", copy=True)
        planner.set_keep_out([((0.0, 30.0), (4.0, 30.0), (4.0, 33.0))])
        planner.fail("d2")
        planner.ask(cases=Cases(iou=0.8), most_price=7.0)
        project.close()
        path.write_bytes((Path(folder) / "a.live.json").read_bytes())
    planner.listen(lambda dragging: None)


def make_picture(path: Path) -> None:
    """Write a picture of 90 x 60 pixels in the format of its name."""
    pixels = np.random.default_rng(0).integers(0, 255, (60, 90, 3), np.uint8)
    Image.fromarray(pixels).save(path)


def read_picture(path: Path) -> None:
    """Lay a picture under the scene, and read it again as a project with a damaged one does."""
    content, area = read_bytes(path), np.array([-40.0, -30.0, 40.0, 30.0])
    with tempfile.TemporaryDirectory() as folder:
        kept = keep_picture(path.name, content, Path(folder), area)
        (Path(folder) / kept.file).write_bytes(content)
        kept.read(Path(folder))


def read_logo(path: Path) -> None:
    """Read a catalogue whose report has this logo."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / path.name).symlink_to(path)
        catalogue = Path(folder) / "sensors.toml"
        row = '[[sensor]]\nmodel = "DepthCamera"\nprice = 1500\n'
        catalogue.write_text(f'{row}[report]\nlogo = "{path.name}"\n')
        load_sensor_catalogue(catalogue)


def make_result(path: Path) -> None:
    """Write the result of a search whose best set was judged."""
    best = Score(
        (0, 3), 0.7, 0.8, 600.0, 1200.0, 2.0, 0.6, {"ap": 0.6}, "surrogate", cache_hit=False
    )
    contenders = (Contender(("greedy",), (0, 3), 0.8, 0.75, 0.7, 0.8),)
    history = History(np.array([1, 5]), np.array([0.1, 0.5]), np.array([0.5, 0.6]))
    judged = Assessment(
        by="detector",
        ap=0.75,
        low=0.7,
        high=0.8,
        kbit=1200.0,
        objects=100,
        frames=16,
        predicted=0.8,
        confidence=0.95,
        asked=0.95,
        tolerance=0.01,
        entrants=9,
        raced=16,
        contenders=contenders,
        by_errors=(ProfileAP("typical", 0.7, 0.6, 0.8),),
    )
    result = Result(
        "greedy",
        best,
        history,
        Certificate("none", 0.6),
        9,
        1.5,
        (best,),
        (best,),
        assessment=judged,
    )
    replace(result, sensors=tuple(load_site("tjunction").sensors[:2])).save(path)


def read_project(path: Path) -> None:
    planner = _planner()
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        copy.write_bytes(read_bytes(path))
        try:
            with said_of(path, folder):
                ProjectFile(copy, planner).close()
        finally:
            planner.listen(lambda dragging: None)
            planner.restore({"A": planner.yard.place(load_site("tjunction").sensors)}, "A", [])
            planner.ask(
                cases=Cases(), most_price=float("inf"), classes=("vehicle",), scheme="early"
            )
