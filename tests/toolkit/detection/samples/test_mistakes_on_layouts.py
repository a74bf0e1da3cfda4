"""The doctor reads each layout and names what is wrong in its files; the whole table is that of bench_doctor."""

import importlib.util
import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from toolkit.calibration.ground import level
from toolkit.datasets.layouts.table import LAYOUTS
from toolkit.datasets.sample import SensorCloud
from toolkit.datasets.samples import open_samples
from toolkit.detection.samples import label_fits
from toolkit.detection.samples.diagnosis import diagnose_samples
from toolkit.detection.samples.label_mistakes import boxes_through
from toolkit.geometry import invert, pose, transform

HERE = Path(__file__).parent
BENCHES = HERE.parents[2] / "benchmarks" / "toolkit"


def load(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


mistakes = load(BENCHES / "written_mistakes.py")
bench = load(BENCHES / "bench_doctor.py")
LABELLED = [name for name in LAYOUTS if mistakes.terms_of(name) and name != "hdf5"]
ALL = list(mistakes.MISTAKES)
SOME = [(layout, ALL[k % len(ALL)]) for k, layout in enumerate(LABELLED)]  # one of each layout, such that all are there


@pytest.fixture(scope="module")
def samples():
    """Cars that drive on flat ground, seen from a pole of two lidars in some place of a map."""
    pole = pose(1.0, -2.0, 0.5, yaw=0.3)
    put, made = [], load(HERE / "test_diagnosis.py").recording(count=4, ground_points=1500)
    for sample in made:
        (cloud,) = sample.clouds
        points = transform(invert(pole), cloud.points).astype(np.float32)
        halves = zip(("106", "105"), np.array_split(points, 2), strict=True)
        clouds = tuple(SensorCloud(name, half, pole) for name, half in halves)
        put.append(replace(sample, clouds=clouds, time=1.7e9 + sample.time, map_SE3_world=bench.PLACE))
    return put


@pytest.fixture(scope="module", autouse=True)
def ground_found_once():
    """Files of labels change here, clouds and their ground do not."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(label_fits, "level", bench.remembered(level))
        yield


@pytest.fixture(scope="module")
def written(samples, tmp_path_factory):
    """Folders of the layouts, each written once."""
    made = {}

    def of(layout):
        if layout not in made:
            made[layout] = tmp_path_factory.mktemp(layout)
            bench.write_layout(samples, made[layout], layout)
        return made[layout]

    return of


def said_of(path, layout):
    return [finding.suspected for finding in diagnose_samples(islice(open_samples(path, layout), 10))]


def check(written, layout, mistake):
    path, terms = written(layout), mistakes.terms_of(layout)
    untouched = terms.read(path)
    try:
        mistakes.make(mistake, path, terms)
        said = said_of(path, layout)
    finally:
        terms.write(path, untouched)
    assert bench.verdict(mistake, said) == "found", said


@pytest.mark.parametrize("layout", LABELLED)
def test_nothing_is_suspected_of_untouched_files(written, layout):
    path, terms = written(layout), mistakes.terms_of(layout)
    terms.write(path, terms.read(path))  # and the bench reads and writes what is there
    assert said_of(path, layout) == []


@pytest.mark.parametrize("layout", LABELLED)
def test_boxes_are_read_within_a_millimetre_and_a_hundredth_of_a_degree(samples, written, layout):
    """Also of the layout that only the bench writes, whose labels are each sensor's own."""
    for before, after in zip(samples, open_samples(written(layout), layout), strict=True):
        a, b = (boxes_through(sample.objects.boxes, sample.map_SE3_world) for sample in (before, after))
        if np.allclose(after.map_SE3_world, np.eye(4)):  # a layout that has no place for a map
            a = before.objects.boxes
        order = [np.lexsort(boxes[:, :2].round(2).T) for boxes in (a, b)]
        a, b = a[order[0]], b[order[1]]
        np.testing.assert_allclose(a[:, :6], b[:, :6], atol=1e-3)
        assert np.rad2deg(np.abs(np.angle(np.exp(1j * (a[:, 6] - b[:, 6]))))).max() < 0.01


@pytest.mark.parametrize(("layout", "mistake"), SOME)
def test_mistakes_are_found(written, layout, mistake):
    check(written, layout, mistake)


@pytest.mark.slow
@pytest.mark.parametrize("mistake", ALL)
@pytest.mark.parametrize("layout", LABELLED)
def test_every_mistake_is_found_on_every_layout(written, layout, mistake):
    check(written, layout, mistake)


def test_every_layout_is_there_but_bags_which_hold_no_labels():
    assert set(LAYOUTS) - set(mistakes.TERMS) == {"rosbag"}
    assert {mistake for _, mistake in SOME} == set(ALL)


def test_a_verdict():
    assert bench.verdict(None, []) == "nothing"
    assert bench.verdict("late", []) == "not found"
    assert bench.verdict("late", ["labels lie about 0.2 s behind the clouds"]) == "found"
    assert bench.verdict("late", ["mirrored: y", "labels lie about"]) == "mirrored: y; labels lie about"
