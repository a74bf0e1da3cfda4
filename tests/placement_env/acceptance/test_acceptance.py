"""The whole comparison of a street with a plan, with a detector that knows the answer."""

import json
from dataclasses import replace

import numpy as np
import pytest

from placement_env.acceptance.acceptance import Promise, accept_street
from placement_env.acceptance.page import build_page, describe_acceptance
from placement_env.acceptance.street_detections import PlannedDetection
from placement_env.report.content import Judgement
from placement_env.report.pages.typesetting import to_html
from placement_env.report.planning.plan_folder import StatedClass
from toolkit.calibration.reference_surface import site_surface
from toolkit.detection.codec import PAPER
from toolkit.detection.paper_schemes import Early
from toolkit.doctor.findings import Finding
from toolkit.frame import Frame
from toolkit.objects import Detections, Objects
from toolkit.rendering.renderer import Renderer
from toolkit.runtime.text_values import replace_infinite
from toolkit.sensors.models import DepthCamera
from toolkit.sites.files import load_site

BUILT_IN = load_site("tjunction")
CAMERA = DepthCamera(width=160, height=120)
SITE = replace(
    BUILT_IN, sensors=tuple(replace(sensor, model=CAMERA) for sensor in BUILT_IN.sensors[:2])
)
CARS = np.array([[0.0, 0.0, 0.8, 4.5, 1.8, 1.6, 0.0], [6.0, 4.0, 0.8, 4.5, 1.8, 1.6, 1.0]])
FRAMES = 84  # ten blocks of eight frames, and some


@pytest.fixture(scope="module")
def surface():
    return site_surface(SITE)


class Street(list):
    """Frames at the site, five seconds apart."""

    site = SITE


def record(objects, frames=FRAMES):
    images = Renderer(SITE, (), SITE.sensors).background
    return Street(
        Frame(SITE.sensors, images, objects, 5.0 * number, number) for number in range(frames)
    )


def sees(cars):
    """A detector that reports these cars wherever it gets points."""

    def detector(points):
        found = cars if len(points) else cars[:0]
        return Detections(found, np.full(len(found), 0.9))

    return detector


def accept(objects, cars, surface, frames=FRAMES, findings=()):
    stated = StatedClass("vehicle", 1.0, 0.7, Judgement(0.98, 0.95, 1.0, 0.98, 1.0, 240, 120))
    planned = PlannedDetection(SITE, sees(cars), Early(), PAPER)
    promise = Promise(SITE, (stated,), recall=0.98)
    return accept_street(
        record(objects, frames), promise, planned, surface, frames, findings=findings
    )


def test_a_street_that_finds_all_keeps_the_promise(surface):
    found = accept(Objects(CARS), CARS, surface)
    assert (found.faults, found.verdict) == ((), "The street keeps the plan's promise.")
    (vehicle,) = found.classes
    assert (vehicle.measured.ap, vehicle.measured.recall, vehicle.hota) == (1.0, 1.0, None)
    assert found.consistency is None
    text = describe_acceptance(found)
    assert "as promised" in text
    page = to_html(build_page(found, "out/plan", "street.hdf5"), None)
    assert "The intervals overlap." in page
    json.dumps(replace_infinite(found.as_dict()), allow_nan=False)


def test_a_street_that_misses_every_other_car_falls_short(surface):
    doctor = Finding("warning", "sensor d0", "it is late", "by 0.1 s", "set its clock")
    found = accept(Objects(CARS), CARS[:1], surface, findings=[doctor])
    assert found.sensor_faults == ()
    assert found.detection_faults[0].startswith("AP of vehicle is 0.500")
    assert "does not keep" in found.verdict
    assert "it is late" in describe_acceptance(found)
    assert "it is late" in to_html(build_page(found, "out/plan", "street.hdf5"), None)


def test_short_recordings_are_not_compared(surface):
    found = accept(Objects(CARS), CARS[:1], surface, frames=6)
    assert found.faults == ()
    assert "too short" in found.verdict
    assert "unknown" in describe_acceptance(found)


def test_without_labels_the_halves_are_compared(surface):
    found = accept(Objects.empty(), CARS, surface)
    assert found.classes == ()
    assert found.consistency.recall == 1.0
    assert found.consistency.detections == 4 * FRAMES
    assert found.faults == ()
    assert "the other half confirms 100%" in describe_acceptance(found)
    page = to_html(build_page(found, "out/plan", "street.hdf5"), None)
    assert "has no labels" in page


def test_a_recording_of_other_sensors_is_refused(surface):
    other = replace(SITE, sensors=tuple(replace(s, name=f"x{s.name}") for s in SITE.sensors))
    planned = PlannedDetection(other, sees(CARS), Early(), PAPER)
    with pytest.raises(ValueError, match="none of the plan's sensors xd0, xd1, but d0, d1"):
        accept_street(record(Objects(CARS), 6), Promise(other, (), recall=1.0), planned, surface, 6)
