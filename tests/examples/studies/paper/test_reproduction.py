"""The paper's experiments, from the recording to the page."""

import csv
import json

import numpy as np
import pytest

from examples.studies.paper import reproduction
from examples.studies.paper.reproduction import FIGURES, PAGE, check_paper_site, run_reproduction
from placement_env.fidelity.table import save_table
from toolkit.boxes import count_points
from toolkit.objects import Detections
from toolkit.runtime.run import Processes

FRAMES = 3
NAMES = (
    "schemes",
    "sensor_sets",
    "pr_curves",
    "shared_regions",
    "point_density",
    "iou_density",
    "benchmarks",
)


class Guess:
    """A car wherever a grid of boxes has points; it fails at one of its calls."""

    digest = "guess"
    calls = 0

    def __init__(self, fails=-1):
        self.fails = fails
        x, y = (each.ravel() for each in np.meshgrid(np.arange(-38, 38, 6.0), [11.6, 15.6]))
        one = np.ones_like(x)
        self.boxes = np.column_stack([x, y, 0.75 * one, 4.4 * one, 1.8 * one, 1.5 * one, 0 * one])

    def __call__(self, points):
        self.calls += 1
        if self.calls == self.fails:
            raise KeyboardInterrupt
        counts = count_points(points, self.boxes)
        return Detections(self.boxes, counts / (counts.max() + 1))[counts > 5]


def run(out, detector, table, **settings):
    return run_reproduction(
        "tjunction",
        out,
        frames=FRAMES,
        recorded=FRAMES,
        detector=lambda recording: detector,
        table=table,
        **settings,
    )


def files(out):
    kept = ("recording", "detections", "table_")
    return {
        path.name: path.read_bytes() for path in out.iterdir() if not path.name.startswith(kept)
    }


@pytest.fixture(scope="module")
def table(tmp_path_factory, exact_table_of):
    path = tmp_path_factory.mktemp("table") / "table.npz"
    save_table(exact_table_of("guess"), path)
    return path


@pytest.fixture(scope="module")
def made(tmp_path_factory, table):
    """The result, the detector, what was written, and the stages."""
    out, detector, stages = tmp_path_factory.mktemp("paper"), Guess(), []
    result = run(
        out, detector, table, processes=Processes(progress=lambda *each: stages.append(each))
    )
    return result, detector, out, stages


@pytest.mark.slow
def test_every_experiment_has_its_files(made):
    result, _, out, _ = made
    assert tuple(each.name for each in result.experiments) == NAMES
    assert {f"{name}.{kind}" for name in NAMES for kind in ("csv", "svg")} <= set(files(out))
    more = {
        "pr_curves_points.csv",
        "point_density_curves.csv",
        "iou_density_bins.csv",
        PAGE,
        FIGURES,
    }
    assert set(files(out)) == more | {f"{name}.{kind}" for name in NAMES for kind in ("csv", "svg")}


def test_the_page_has_figures_and_conditions(made):
    result, _, out, _ = made
    assert result.page == out / PAGE
    result, _, out, _ = made
    page = (out / PAGE).read_text()
    early = next(row for row in result.experiments[0].rows if row.labels == ("early", "AP@0.7"))
    for cell in early.cells[3:6]:
        assert cell in page
    assert "0.9870" in page
    assert f"{early.ours - 0.9870:+.4f}" in page
    assert f"{FRAMES} frames, seed 2001, {result.vehicles} vehicles" in page
    assert "noise of 1.5 cm" in page
    assert "The detector is not the shipped one" in page
    assert f"coview reproduce tjunction --frames {FRAMES}" in page
    result, _, out, _ = made


def test_tables_and_json_have_the_same_figures(made):
    result, _, out, _ = made
    rows = list(csv.DictReader((out / "schemes.csv").read_text().splitlines()))
    values = json.loads((out / FIGURES).read_text())
    assert [float(row["ours"]) for row in rows] == [
        row["ours"] for row in values["experiments"][0]["rows"]
    ]
    assert [each["name"] for each in values["experiments"]] == list(NAMES)
    assert values["conditions"]["sensor sets"] == "exact table of 12 frames, 50 vehicles"
    assert result.as_dict()["frames"] == FRAMES


def test_stages_are_told_up_to_the_last_frame(made):
    stages = made[3]
    assert ("frames simulated", FRAMES, FRAMES) in stages
    assert ("frames detected", FRAMES, FRAMES) in stages


def test_large_differences_are_listed(made):
    result = made[0]
    large = [row for each in result.experiments for row in each.rows if row.large]
    assert large
    assert all(abs(row.difference) > 0.05 and row.reason for row in large)
    lines = result.summary.splitlines()
    assert lines[0] == f"tjunction: {FRAMES} frames, {result.vehicles} vehicles"
    assert [line.split()[0] for line in lines[2:]] == [
        *("schemes", "sensor_sets", "pr_curves", "shared_regions", "benchmarks")
    ]
    assert lines[2].split()[1] == "9"


@pytest.mark.slow
def test_the_same_bytes_again_without_the_detector(made, table):
    _, _, out, _ = made
    before, never = files(out), Guess(fails=1)
    for name in before:
        (out / name).unlink()
    run(out, never, table)
    assert never.calls == 0
    assert files(out) == before


@pytest.mark.slow
def test_a_killed_run_resumes(made, table, tmp_path):
    _, whole, out, _ = made
    (tmp_path / f"recording_{FRAMES}.hdf5").write_bytes(
        (out / f"recording_{FRAMES}.hdf5").read_bytes()
    )
    killed, rest = Guess(fails=whole.calls - 3), Guess()
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, killed, table)
    assert not (tmp_path / PAGE).exists()
    run(tmp_path, rest, table)
    assert rest.calls < whole.calls / 2
    for name in (
        "sensor_sets.csv",
        "shared_regions.csv",
        "pr_curves_points.csv",
        "iou_density_bins.csv",
    ):
        assert (tmp_path / name).read_bytes() == (out / name).read_bytes()


def test_fewer_frames_need_no_detector(made, table, unwritten):
    _, _, out, _ = made
    never = Guess(fails=1)
    fewer = run_reproduction(
        "tjunction", out, frames=1, recorded=FRAMES, detector=lambda _: never, table=table
    )
    assert (fewer.frames, never.calls) == (1, 0)


def test_another_recording_in_its_place_is_refused(table, tmp_path):
    (tmp_path / f"recording_{FRAMES}.hdf5").write_bytes(b"damaged")
    with pytest.raises(FileExistsError, match="is damaged or no test recording: remove it"):
        run(tmp_path, Guess(), table)


def test_a_table_that_does_not_fit_is_refused(made, tmp_path, exact_table_of):
    _, _, out, _ = made
    save_table(exact_table_of("another"), tmp_path / "another.npz")
    save_table(exact_table_of("guess", "roundabout"), tmp_path / "elsewhere.npz")
    for name, words in (
        ("another", "measured with another detector"),
        ("elsewhere", "with other sensors"),
    ):
        with pytest.raises(ValueError, match=words):
            run(out, Guess(fails=1), tmp_path / f"{name}.npz")


@pytest.fixture
def unwritten(monkeypatch):
    monkeypatch.setattr(reproduction, "all_experiments", lambda *_: ())
    monkeypatch.setattr(reproduction, "write_experiments", lambda *_, **__: None)


def test_a_table_is_made_and_kept_if_none_fits(made, exact_table_of, monkeypatch, unwritten):
    _, _, out, _ = made
    asked = []

    def make(renders, detector, path, *, frames, **settings):
        asked.append((frames, detector.digest, path.name))
        save_table(exact_table_of("guess"), path)
        return exact_table_of("guess")

    monkeypatch.setattr(reproduction, "make_table", make)
    run(out, Guess(fails=1), None)
    run(out, Guess(fails=1), None)
    assert len(asked) == 1
    assert asked[0][:2] == (FRAMES, "guess")
    path = out / asked[0][2]
    path.write_bytes(path.read_bytes()[:100])
    run(out, Guess(fails=1), None)
    assert len(asked) == 2
    path.unlink()


@pytest.mark.parametrize("site", ["general", "site.json", ""])
def test_the_paper_has_figures_for_two_sites(site):
    with pytest.raises(
        ValueError, match=f"the paper has figures for tjunction and roundabout, not for '{site}'"
    ):
        check_paper_site(site)


@pytest.mark.parametrize("frames", [0, -1])
def test_refuses_frames(tmp_path, frames):
    with pytest.raises(ValueError, match="frames must be a whole number of at least 1"):
        run_reproduction("tjunction", tmp_path, frames=frames)
