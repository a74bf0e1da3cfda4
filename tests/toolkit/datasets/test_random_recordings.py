"""Recordings of random sites: what they promise, and that a site that fails is left out with a
note."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from toolkit.bodies.fleet import HELD_OUT, catalogue, fleet_named
from toolkit.boxes import footprints
from toolkit.datasets import simulation as module
from toolkit.datasets.simulation import random_recording, random_recordings_file
from toolkit.objects import VEHICLE
from toolkit.runtime.run import Run
from toolkit.sites.files import format_site, load_site
from toolkit.sites.random import random_site


def digest(recording):
    """Comparable, and small enough to send."""
    sums = [float(image.sum()) for frame in recording.frames for image in frame.measurements]
    return recording.site.name, tuple(sums), tuple(len(frame.objects) for frame in recording.frames)


@pytest.fixture(scope="module")
def recording():
    return random_recording(seed=4, number=1, frames=3)


@pytest.mark.slow
def test_a_recording_is_whole_by_seed_and_number(recording):
    assert len(recording.frames) == 3
    sensors = recording.frames[0].sensors
    assert module.MIN_RANDOM_SENSORS <= len(sensors) <= module.MAX_RANDOM_SENSORS
    for frame in recording.frames:
        assert frame.sensors == sensors
        for image, empty in zip(frame.measurements, recording.empty, strict=True):
            assert image.shape == empty.shape
            assert (
                image[image != empty] > 0
            ).all()  # what comes in front of the site returns something
            hidden = (image > 0) & (empty > 0)
            assert (image[hidden] <= empty[hidden]).all()
    assert any(len(frame.objects) for frame in recording.frames)
    assert digest(recording) == digest(random_recording(seed=4, number=1, frames=3))
    assert digest(recording) != digest(random_recording(seed=4, number=2, frames=3))


@pytest.mark.slow
def test_site_files_are_recorded_in_turn_instead_of_drawn_junctions(tmp_path):
    paths = [tmp_path / f"{k}.json" for k in range(2)]
    for k, path in enumerate(paths):
        path.write_text(format_site(random_site(np.random.default_rng(60 + k))))
    made = [random_recording(seed=4, number=number, frames=1, sites=paths) for number in range(3)]
    assert [each.site.name for each in made] == [load_site(paths[k]).name for k in (0, 1, 0)]
    assert digest(made[0]) != digest(made[2])  # other sensors and traffic there
    out, run, settings = (
        tmp_path / "x.packed",
        Run(frames=1, seed=4, workers=1),
        {"encode": as_text, "join": as_lines},
    )
    random_recordings_file(2, out, run=run, **settings, sites=paths)
    assert out.read_text() == "\n".join(repr(digest(each)) for each in made[:2])


@pytest.mark.slow
def test_everyone_is_drawn_afresh_or_stretched():
    recording = random_recording(seed=4, number=1, frames=3, fleet=fleet_named("catalogue"))
    sizes = np.concatenate(
        [f.objects.boxes[f.objects.labels == VEHICLE, 3:6] for f in recording.frames]
    )
    training = np.array([body.size for body in catalogue() if body.label == VEHICLE])
    assert not {body.name for body in catalogue()} & set(HELD_OUT)
    stretch = sizes[:, None] / training
    nearest = np.abs(stretch - 1).max(axis=2).min(axis=1)
    assert (nearest < 0.07).all()
    assert (nearest > 1e-4).any()
    own = fleet_named("own")
    first, again = (
        random_recording(seed=4, number=1, frames=2, fleet=fleet) for fleet in (None, own)
    )
    assert digest(first) == digest(again)
    sizes = np.concatenate(
        [f.objects.boxes[f.objects.labels == VEHICLE, 3:6] for f in first.frames]
    )
    assert len({tuple(size) for size in sizes.round(4).tolist()}) > 5


class Noted:
    """Stands for drawing: what was drawn, and a kill when its time has come."""

    def __init__(self, kill_at=None):
        self.numbers, self.kill_at = [], kill_at

    def __call__(self, seed, number, frames, *, fleet, sites):
        if number == self.kill_at:
            raise KeyboardInterrupt
        if number == 2:
            raise ValueError("no road")
        self.numbers.append(number)
        return f"{seed} {number} {frames}"


def as_bytes(drawn):
    return drawn.encode()


def as_lines(paths, target):
    lines = [path.read_text() for path in paths]
    target.write_text("\n".join(lines))
    return len(lines)


def as_text(recording):
    return repr(digest(recording)).encode()


@pytest.fixture
def draw_by(monkeypatch):
    """Draw recordings by another function: `draw_by(function)`."""

    def set_function(function):
        monkeypatch.setattr(module, "random_recording", function)

    return set_function


@pytest.mark.slow
def test_the_number_of_workers_changes_nothing(tmp_path):
    for workers in (1, 2):
        run = Run(frames=2, seed=5, workers=workers)
        assert (
            random_recordings_file(
                3, tmp_path / str(workers), run=run, encode=as_text, join=as_lines
            )
            == 3
        )
    assert (tmp_path / "1").read_text() == (tmp_path / "2").read_text()


def test_a_file_of_recordings_goes_on_where_it_was_killed(tmp_path, draw_by):
    out, first, second = tmp_path / "x.packed", Noted(kill_at=3), Noted()
    settings = {"encode": as_bytes, "join": as_lines}
    run, done = Run(frames=4, seed=7), []
    draw_by(first)
    with pytest.raises(KeyboardInterrupt):
        random_recordings_file(5, out, run=run, **settings)
    assert not out.exists()
    with pytest.raises(FileExistsError, match="seed 7 instead of 8"):
        random_recordings_file(5, out, run=replace(run, seed=8), **settings)
    with pytest.raises(FileExistsError, match=r"fleet 0 .* instead of 47 "):
        random_recordings_file(5, out, run=run, **settings, fleet=fleet_named("catalogue"))
    draw_by(second)
    told = replace(run, progress=lambda name, count, total: done.append((count, total)))
    with pytest.warns(UserWarning, match="random site 2 of seed 7 left out: ValueError: no road"):
        assert random_recordings_file(5, out, run=told, **settings) == 4
    assert (first.numbers, second.numbers, done) == ([0, 1], [3, 4], [(4, 5), (5, 5)])
    assert out.read_text().split("\n") == ["7 0 4", "7 1 4", "7 3 4", "7 4 4"]
    assert [path.name for path in tmp_path.iterdir()] == ["x.packed"]


def test_a_long_reason_is_cut_and_stays_readable(tmp_path, draw_by):
    def fail(seed, number, frames, *, fleet, sites):
        if number == 0:
            return "drawn"
        raise ValueError("ä" * 3000 if number == 1 else "x" + "ä" * 3000)

    draw_by(fail)
    run = Run(frames=4, seed=7)
    with pytest.warns(UserWarning, match="left out: ValueError: x?ä{900}"):
        count = random_recordings_file(3, tmp_path / "x", run=run, encode=as_bytes, join=as_lines)
    assert count == 1


def test_another_run_is_dropped_when_told_to(tmp_path, draw_by):
    out = tmp_path / "x.packed"
    draw_by(Noted(kill_at=1))
    with pytest.raises(KeyboardInterrupt):
        random_recordings_file(2, out, run=Run(frames=4, seed=7), encode=as_bytes, join=as_lines)
    draw_by(Noted())
    random_recordings_file(
        2, out, run=Run(frames=4, seed=8), encode=as_bytes, join=as_lines, overwrite=True
    )
    assert out.read_text() == "8 0 4\n8 1 4"


def test_a_file_is_of_the_fleet_that_is_asked_for(tmp_path, draw_by):
    asked = []

    def drawn(seed, number, frames, *, fleet, sites):
        asked.append(fleet)
        return "drawn"

    draw_by(drawn)
    fleet = fleet_named("own")
    random_recordings_file(
        2, tmp_path / "x", run=Run(frames=4, seed=8), encode=as_bytes, join=as_lines, fleet=fleet
    )
    assert asked == [fleet, fleet]


def test_no_sites_are_refused_before_anything_is_written(tmp_path):
    with pytest.raises(ValueError, match="at least one site"):
        random_recordings_file(0, tmp_path / "x", encode=as_bytes, join=as_lines)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.one_in(3)
@pytest.mark.parametrize("number", range(3))
def test_what_moves_touches_nothing_that_stands(number):
    """A minute and more of traffic at sites with works, crowns and bays: every body is clear of
    every solid."""
    recording = random_recording(seed=12, number=number, frames=14)
    solids = [solid for solid in recording.site.solids if solid.kind not in ("kerb", "island")]
    tree = shapely.STRtree([shapely.Polygon(solid.footprint) for solid in solids])
    for frame in recording.frames:
        boxes = frame.objects.boxes
        rows, hits = tree.query(shapely.polygons(footprints(boxes)), predicate="intersects")
        tops = boxes[rows, 2] + boxes[rows, 5] / 2
        assert all(solids[hit].base > top - 0.3 for hit, top in zip(hits, tops, strict=True))
    assert max([len(frame.objects) for frame in recording.frames]) <= 24 + module.MAX_PARKED
