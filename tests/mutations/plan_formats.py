"""Folders of plans and projects of the live planner: small sound ones, and what reads them."""

import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

import shapely

from placement_env import LivePlanner
from placement_env.candidates.sensor_catalogue import PricedModel, SensorCatalogue
from placement_env.cases import Cases
from placement_env.handover.exchange import SITE
from placement_env.handover.mounted import mounted_site
from placement_env.live.project import ProjectFile
from placement_env.report.content import PLAN_VERSION
from placement_env.report.planning.plan_folder import CONTENT, format_stock, read_plan_folder
from placement_env.report.planning.question import Question, Stock
from placement_env.setting import Setting
from toolkit.runtime.files import read_bytes
from toolkit.runtime.run import Run
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sites.files import load_site, save_site

EYE = PricedModel("eye", DepthCamera(width=120, height=90), 1500.0)
TURNING = PricedModel("turning", SpinningLidar(channels=16), 4000.0)
CATALOGUE = SensorCatalogue((EYE, TURNING), "EUR", 900.0, "0" * 64, {"cable": 900.0, "power": 60.0}, 5.0)
KEEP_OUT = (shapely.box(30.0, 10.0, 35.0, 15.0),)
CASES = Cases(iou=0.5, errors=("typical",))


def make_question(**options: object) -> Question:
    """Question of a plan that asks for nothing usual."""
    stock = Stock(catalogue=CATALOGUE, keep_out=KEEP_OUT, capacity_kbit=1234.0)
    setting = Setting(
        "tjunction", candidates=stock, scheme="late", classes=("vehicle", "pedestrian"), cases=CASES, most_price=9000.0
    )
    return Question(setting, Run(seed=5, frames=3), sensors=3, **options)


def write_plan_folder(question: Question, members: list[int], folder: Path) -> dict[str, object]:
    """Write site.json and plan.json of a plan that nothing computed; return the content of plan.json."""
    candidates = question.setting.pool
    site = mounted_site(question.site, candidates, members)
    folder.mkdir(parents=True, exist_ok=True)
    save_site(site, folder / SITE)
    poles = [candidates.mounts[mount].name for mount in candidates.mount[members]]
    sensors = [{"name": sensor.name, "pole": pole} for sensor, pole in zip(site.sensors, poles, strict=True)]
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
    (folder / CONTENT).write_text(json.dumps(plan, indent=1))
    return plan


@lru_cache
def _sound_site() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        write_plan_folder(make_question(), [3, 500], Path(folder))
        return (Path(folder) / SITE).read_bytes()


def make_plan(path: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        write_plan_folder(make_question(), [3, 500], Path(folder))
        path.write_bytes((Path(folder) / CONTENT).read_bytes())


def read_plan(path: Path) -> None:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / SITE).write_bytes(_sound_site())
        (Path(folder) / CONTENT).symlink_to(path)
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
    """Write a project with two variants, a pole at free ground, an area, a picture and another question."""
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
    planner.tell = lambda dragging: None


def read_project(path: Path) -> None:
    planner = _planner()
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        copy.write_bytes(read_bytes(path))
        try:
            with said_of(path, folder):
                ProjectFile(copy, planner).close()
        finally:
            planner.tell = lambda dragging: None
            planner.restore({"A": planner.yard.place(load_site("tjunction").sensors)}, "A", [])
            planner.ask(cases=Cases(), most_price=float("inf"), classes=("vehicle",), scheme="early")
