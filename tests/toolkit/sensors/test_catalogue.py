"""Models are found by name, made from what files say, and only what is a model is registered."""

from dataclasses import dataclass

import pytest

from toolkit.sensors.catalogue import MODELS, class_names, make_model, model_class, model_named, register_sensor_model
from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.solid_state_lidar import SolidStateLidar
from toolkit.sensors.spinning_lidar import SpinningLidar


@dataclass(frozen=True)
class Blind:
    pixels: int = 3


@dataclass(frozen=True)
class Bare:
    pixels: int


@dataclass
class Loose:
    pixels: int = 3


@dataclass(frozen=True)
class Typed:
    type: str = "x"


@pytest.mark.parametrize("model", [DepthCamera, SpinningLidar, SolidStateLidar])
def test_shipped_models_have_a_name_in_files_and_one_in_words(model):
    assert model.__name__ in class_names()
    assert model_class(model.__name__) is model
    assert model_named(model.__name__) == model()


def test_names_in_words_are_those_of_the_classes():
    assert {"depth-camera", "spinning-lidar", "solid-state-lidar"} <= set(MODELS)
    assert model_named("solid-state-lidar") == model_named("solid_state_lidar") == SolidStateLidar()


@pytest.mark.parametrize("name", ["radar", "", "os.system", "DepthCamera()", "toolkit.sensors.depth_camera"])
def test_other_names_are_refused_with_those_there_are(name):
    with pytest.raises(ValueError, match=r"there are DepthCamera, SpinningLidar, SolidStateLidar") as refusal:
        model_named(name)
    assert "\n" not in str(refusal.value)


def test_files_make_models():
    assert make_model("DepthCamera", {"centre": [30.0, 20.0]}) == DepthCamera(centre=(30.0, 20.0))
    assert make_model("DepthCamera", {"centre": None, "width": 300}) == DepthCamera(width=300)


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("DepthCamera", {"zoom": 2}, "zoom is unknown to DepthCamera: it has width"),
        ("DepthCamera", {"centre": 3}, "centre"),
        ("DepthCamera", {"width": "wide"}, "width must be a whole number, got 'wide'"),
        ("SolidStateLidar", {"rows": [1, 2]}, "rows must be a whole number"),
        ("SpinningLidar", {"sigma": None}, "sigma must be a number, got None"),
    ],
)
def test_nonsense_of_files_is_refused(name, values, message):
    # values of another type meet the shape checker first, where tests run with it
    with pytest.raises(ValueError, match=f"{message}|Type-check error"):
        make_model(name, values)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (Blind, "Blind is no SensorModel, it lacks .*rays"),
        (int, "int must be a frozen dataclass"),
        (Loose, "Loose must be a frozen dataclass"),
        (Bare, "fields of Bare need defaults"),
        (Typed, "no name of"),
        (type("DepthCamera", (DepthCamera,), {}), "there is a sensor model DepthCamera already"),
    ],
)
def test_what_is_no_model_is_not_registered(model, message):
    before = dict(MODELS)
    with pytest.raises(ValueError, match=message):
        register_sensor_model(model)
    assert before == MODELS
