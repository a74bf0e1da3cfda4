"""Project files: every change is saved, whatever kills the process, and a damaged file is
refused."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from placement_env import LivePlanner
from placement_env.cases import Cases
from placement_env.live.picture import GroundPicture
from placement_env.live.project import (
    MAX_SAVED_STEPS,
    MAX_VARIANTS,
    ProjectFile,
    export_variant,
    report_variant,
)
from placement_env.live.variant import Variant
from placement_env.report.planning import plan_writing, planning
from placement_env.setting import Setting
from toolkit.sites.files import load_site


@pytest.fixture(scope="module")
def made():
    return LivePlanner("tjunction", frames=4)


@pytest.fixture
def planner(made):
    made.restore({"A": made.yard.place(made.yard.site.sensors)}, "A", [])
    made.listen(lambda dragging: None)
    return made


@pytest.fixture
def path(tmp_path):
    return tmp_path / "junction.json"


def reopen(path, made, **options):
    """Variants, the shown one and steps of a project, as another process would find them."""
    made.listen(lambda dragging: None)
    made.restore({"other": Variant()}, "other", [])
    project = ProjectFile(path, made, **options)
    project.close()
    return made.variants, made.current, made.past_steps


def test_everything_is_there_again(planner, path):
    project = ProjectFile(path, planner)
    planner.move("d0", heading=1.0)
    planner.show("low <b>", copy=True)
    xmin, ymin, xmax, ymax = planner.yard.site.area
    spots = ((x, y) for x in np.arange(xmin, xmax, 3.0) for y in np.arange(ymin, ymax, 3.0))
    feet = np.array([mount.position[:2] for mount in planner.yard.stock.mounts])
    planner.move(
        "d1",
        position=next(
            s
            for s in spots
            if not planner.yard.refusal_reason(s) and np.hypot(*(feet - s).T).min() > 2
        ),
    )
    planner.fail("d2")
    planner.lock("d3")
    kept = dict(planner.variants), planner.current, planner.past_steps
    project.close()
    variants, current, past = reopen(path, planner)
    assert json.dumps([v.as_dict() for v in variants.values()]) == json.dumps(
        [v.as_dict() for v in kept[0].values()]
    )
    assert (list(variants), current, len(past)) == (list(kept[0]), kept[1], len(kept[2]))
    planner.undo()
    assert not planner.variant.find("d3").locked


def test_drags_are_saved_now_and_then_and_at_their_end(planner, path):
    project = ProjectFile(path, planner)
    texts = set()
    for heading in np.linspace(0, 0.5, 30):
        planner.move("d0", heading=heading, dragging=True)
        texts.add(path.read_text())
    project.save()
    assert len(texts) < 30
    assert json.loads(path.read_text())["variants"]["A"]["sensors"][0]["heading"] == 0.5
    project.close()


def test_steps_are_bounded(planner, path):
    project = ProjectFile(path, planner)
    for k in range(MAX_SAVED_STEPS + 20):
        planner.lock("d0", locked=k % 2 == 0)
    assert len(json.loads(path.read_text())["past"]) == MAX_SAVED_STEPS
    project.close()


def test_one_writer(planner, path):
    project = ProjectFile(path, planner)
    with pytest.raises(ValueError, match="open in another coview live"):
        ProjectFile(path, planner)
    project.close()
    ProjectFile(path, planner).close()


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda text: text[: len(text) // 2], "damaged|line"),
        (lambda text: "[]", "must be an object"),
        (lambda text: text.replace('"coview_live": 1', '"coview_live": 99'), "coview_live"),
        (lambda text: text.replace('"site_sha256": "', '"site_sha256": "0'), "another site"),
        (
            lambda text: text.replace('"heading": 1.0', '"heading": "north"'),
            r"A.sensors\[0\].heading must be a finite number",
        ),
        (lambda text: text.replace('"heading": 1.0', '"heading": 1e999'), "finite|must be"),
        (lambda text: text.replace('"mount": "post00"', '"mount": "moon"'), "no pole 'moon'"),
        (lambda text: text.replace('"name": "d1"', '"name": "d0"'), "must differ"),
        (lambda text: text.replace('"name": "d1"', '"name": "d\\u0000"'), "one line"),
        (lambda text: text.replace('"model": "depth-camera"', '"model": "eye"'), "no model 'eye'"),
        (lambda text: text.replace('"current": "A"', '"current": "Z"'), "shown variant"),
        (lambda text: text.replace('"past": [[', '"past": [["A"],['), "past step"),
    ],
)
def test_a_damaged_file_is_refused_and_the_last_good_state_offered(planner, path, damage, said):
    project = ProjectFile(path, planner)
    planner.move("d0", heading=1.0)
    planner.move("d0", tilt=0.5)
    project.close()
    good, damaged = path.read_text(), damage(path.read_text())
    assert damaged != good
    path.write_text(damaged)
    with pytest.raises(ValueError, match=said) as refused:
        reopen(path, planner)
    assert "--last-good" in str(refused.value)
    assert path.read_text() == damaged
    variants, _, _ = reopen(path, planner, last_good=True)
    assert variants["A"].find("d0").heading == 1.0
    assert variants["A"].find("d0").tilt != 0.5


def test_no_last_good_state(planner, path):
    with pytest.raises(ValueError, match="without --last-good"):
        reopen(path, planner, last_good=True)


KILLED = """
import sys
from pathlib import Path
from placement_env import LivePlanner
from placement_env.live.project import ProjectFile
planner = LivePlanner("tjunction", frames=1)
planner.answer = lambda what="": None
project = ProjectFile(Path(sys.argv[1]), planner)
for k in range(100000):
    planner.move("d0", heading=k / 1000 % 3)
    print(planner.sensors[0].heading, flush=True)
"""


@pytest.mark.slow
def test_a_killed_process_leaves_what_it_has_said(planner, path):
    """Whenever kill -9 comes, the file holds the last change that was answered, or the one after
    it."""
    for wait in (3, 40, 111):
        process = subprocess.Popen(
            [sys.executable, "-c", KILLED, path], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        said = [float(process.stdout.readline()) for _ in range(wait)]
        os.kill(process.pid, signal.SIGKILL)
        said += [float(line) for line in process.stdout.read().splitlines()]
        process.wait()
        variants, _, past = reopen(path, planner)
        assert -1e-9 <= variants["A"].find("d0").heading - said[-1] <= 0.0011
        assert past
        path.unlink()


ASKED = """
import sys, time
from pathlib import Path
from placement_env import LivePlanner
from placement_env.live.project import ProjectFile
planner = LivePlanner("tjunction", frames=4)
project = ProjectFile(Path(sys.argv[1]), planner)
planner.ask(classes=("cyclist", "pedestrian"), scheme="late", most_price=4)
print(planner.answer().ap, flush=True)
time.sleep(100)
"""


def test_a_killed_process_leaves_the_question_that_was_asked(path):
    process = subprocess.Popen(
        [sys.executable, "-c", ASKED, path], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    ap = float(process.stdout.readline())
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    again = LivePlanner("tjunction", frames=4)
    ProjectFile(path, again).close()
    assert again.question == {
        "classes": ["cyclist", "pedestrian"],
        "scheme": "late",
        "most_price": 4,
    }
    assert again.answer().ap == pytest.approx(ap, abs=1e-9)


def test_an_export_is_what_search_writes_and_reads_back(planner, tmp_path):
    planner.move("d0", heading=1.0, position="pole05")
    answer = planner.finish()
    site, plan, schedule = sorted(
        export_variant(planner, tmp_path / "out"), key=lambda each: each.suffix != ".json"
    )
    assert [each.name for each in (site, plan, schedule)] == [
        "site.json",
        "schedule.csv",
        "plan.geojson",
    ]
    found = load_site(site)
    again = LivePlanner(Setting(found, candidates="pool"), frames=4)
    assert again.finish().ap == pytest.approx(answer.ap, abs=0.005)
    assert [sensor.mount for sensor in again.sensors] == [
        sensor.mount for sensor in planner.sensors
    ]
    planner.restore({"A": replace(planner.variant, sensors=())}, "A", [])
    with pytest.raises(ValueError, match="no sensor to export"):
        export_variant(planner, tmp_path / "none")


def test_the_question_is_kept(path):
    planner = LivePlanner("tjunction", frames=4)
    project = ProjectFile(path, planner)
    asked = planner.ask(
        classes=("cyclist", "pedestrian"), cases=Cases(errors="glare"), scheme="late", most_price=4
    )
    with pytest.raises(ValueError, match="of one IoU"):
        planner.ask(cases=Cases(iou="0.5:0.95"))
    planner.lay(GroundPicture("plan.png", "picture-0123456789ab.jpg", 800, 600, 1.0, 2.0, 0.1, 0.5))
    project.close()
    again = LivePlanner("tjunction", frames=4)
    ProjectFile(path, again).close()
    assert again.picture == planner.picture
    assert again.question == planner.question
    assert again.question["errors"] == ["glare"]
    assert again.answer().ap == asked.ap
    assert again.answer().budget == 4
    again.listen(lambda dragging: None)
    kept = json.loads(path.read_text())
    bad = (
        {"iou": 5},
        {"iou": [3]},
        {"classes": ["cow"]},
        {"scheme": 3},
        {"most_price": "x"},
        {"errors": [1]},
        [1],
    )
    for question in (*bad, {"colour": 1}):
        path.write_text(json.dumps(kept | {"question": question}))
        with pytest.raises(ValueError, match=r"junction\.json: "):
            ProjectFile(path, again)
    for picture in ({**kept["picture"], "file": "/etc/passwd"}, {"name": "a"}, 3):
        path.write_text(json.dumps(kept | {"picture": picture}))
        with pytest.raises(ValueError, match=r"junction\.json: "):
            ProjectFile(path, again)


def test_as_many_variants_as_allowed_are_read_and_no_more(planner, path):
    project = ProjectFile(path, planner)
    planner.show("B", copy=True)
    project.close()
    content = json.loads(path.read_text())
    row = content["variants"]["A"]
    for count, fits in ((MAX_VARIANTS, True), (MAX_VARIANTS + 1, False), (0, False)):
        variants = dict.fromkeys(("A", "B", *(f"v{k}" for k in range(count - 2)))[:count], row)
        path.write_text(json.dumps({**content, "variants": variants}))
        if fits:
            assert len(reopen(path, planner)[0]) == count
        else:
            with pytest.raises(ValueError, match=f"it needs 1 to {MAX_VARIANTS} variants"):
                reopen(path, planner)


def test_everything_in_the_file_is_taken_over_and_kept_again(planner, path):
    project = ProjectFile(path, planner)
    planner.show("B", copy=True)
    planner.move("d0", heading=1.0)
    planner.ask(cases=Cases(iou=0.8, errors=("typical",)), scheme="late", most_price=4.0)
    project.close()
    before = path.read_text()
    content = json.loads(before)
    assert content["question"] == {
        "iou": [0.8],
        "errors": ["typical"],
        "scheme": "late",
        "most_price": 4.0,
    }
    assert (content["current"], content["coview_live"], content["picture"]) == ("B", 1, None)
    planner.ask(cases=Cases(), scheme="early", most_price=float("inf"))
    again = reopen(path, planner)
    assert (list(again[0]), again[1], len(again[2])) == (["A", "B"], "B", 1)
    assert planner.question == content["question"]
    assert json.loads(path.read_text()) == content
    planner.ask(cases=Cases(), scheme="early", most_price=float("inf"))
    assert planner.question == {}


def test_an_export_replaces_no_site_or_plan_of_others(planner, tmp_path):
    (tmp_path / "site.json").write_text("{}")
    with pytest.raises(ValueError, match=r"holds a site\.json that no export wrote"):
        export_variant(planner, tmp_path)
    (tmp_path / "plan").mkdir()
    (tmp_path / "plan/plan.json").write_text("{}")
    with pytest.raises(ValueError, match="is the folder of a plan, which an export would change"):
        export_variant(planner, tmp_path / "plan")
    for _ in range(2):
        written = export_variant(planner, tmp_path / "new")
    assert sorted(path.name for path in written) == ["plan.geojson", "schedule.csv", "site.json"]
    assert (tmp_path / "site.json").read_text() == "{}"


def test_a_report_judges_the_sensors_as_they_hang_and_keeps_their_poles(
    planner, tmp_path, monkeypatch
):
    asked = []
    monkeypatch.setattr(planning, "plan", asked.append)
    monkeypatch.setattr(plan_writing, "write_plan", lambda plan, folder: [folder / "report.html"])
    planner.move("d0", heading=1.0)
    assert report_variant(planner, tmp_path) == [tmp_path / "report.html"]
    (question,) = asked
    setting = question.setting
    assert question.sensors == len(planner.sensors) == len(setting.pool)
    assert set(setting.keep) == {sensor.mount for sensor in planner.sensors}
    assert [sensor.name for sensor in setting.pool.sensors] == [
        sensor.name for sensor in planner.sensors
    ]
    assert setting.fusion == planner.asked_setting.fusion
    assert question.run.frames is None
