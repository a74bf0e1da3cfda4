"""All known sensor models by name: what files may hold and the command line offers.

A model defined elsewhere becomes known by `register_sensor_model`, as `@register_sensor_model` above its class.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, TypeVar

from toolkit.sensors.depth_camera import DepthCamera
from toolkit.sensors.model import SensorModel
from toolkit.sensors.row_lidar import RowLidar
from toolkit.sensors.solid_state_lidar import SolidStateLidar
from toolkit.sensors.spinning_lidar import SpinningLidar

MODELS: dict[str, type[Any]] = {}  # by the name of the class in words, such as "depth-camera"
TAKEN = ("name", "model", "type", "site_SE3_sensor")  # what files say of a sensor beside the fields of its model

Model = TypeVar("Model", bound=type)


def register_sensor_model(model: Model) -> Model:
    """Make a model known, so that files with it can be read and `--model` names it; returns the class.

    Raises ValueError where the class is no `toolkit.sensors.model.SensorModel` of fields with defaults, or its name is
    taken by another one.
    """
    name = model.__name__
    parameters = getattr(model, "__dataclass_params__", None)
    if not is_dataclass(model) or parameters is None or not (parameters.frozen and parameters.eq):
        raise ValueError(f"{name} must be a frozen dataclass that compares by value: put @dataclass(frozen=True) on it")
    bare = [f.name for f in fields(model) if f.default is MISSING and f.default_factory is MISSING]
    if bare or {f.name for f in fields(model)} & set(TAKEN):
        raise ValueError(f"fields of {name} need defaults ({', '.join(bare) or 'all have'}) and no name of {TAKEN}")
    if not isinstance(model(), SensorModel):
        known = (each for each in dir(SensorModel) if not each.startswith("_"))
        lacks = ", ".join(each for each in known if not hasattr(model, each))
        raise ValueError(f"{name} is no SensorModel, it lacks {lacks}: see toolkit.sensors.model")
    before = MODELS.get(name_in_words(name), model)
    if (before.__module__, before.__qualname__) != (model.__module__, model.__qualname__):
        raise ValueError(f"there is a sensor model {name} already, in {before.__module__}: name this one otherwise")
    MODELS[name_in_words(name)] = model
    return model


def model_named(name: str) -> SensorModel:
    """The model of that name, such as "solid-state-lidar" or SolidStateLidar, with its default parameters.

    Raises ValueError that lists what there is.
    """
    return model_class(name)()


def model_class(name: str) -> type[Any]:
    """The class of that name, as files write it or in words. Raises ValueError that lists what there is."""
    if name_in_words(str(name)) not in MODELS:
        raise ValueError(f"no sensor model {str(name)[:60]!r}: there are {', '.join(class_names())}")
    return MODELS[name_in_words(str(name))]


def class_names() -> list[str]:
    """The names of all known models as files write them."""
    return [model.__name__ for model in MODELS.values()]


def make_model(name: str, values: Mapping[str, Any]) -> SensorModel:
    """A model from what a file says of it: its name and some of its fields, angles in rad, lists for tuples.

    Raises ValueError where the name is unknown, a field too, or the model refuses a value.
    """
    model = model_class(name)
    known = [entry.name for entry in fields(model)]
    unknown = [key for key in values if key not in known]
    if unknown:
        raise ValueError(f"{unknown[0]} is unknown to {model.__name__}: it has {', '.join(known)}")
    numbers = {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
    try:
        return model(**numbers)
    except TypeError as error:
        raise ValueError(f"{model.__name__} cannot have {numbers} ({error})") from None


def name_in_words(name: str) -> str:
    """SolidStateLidar as solid-state-lidar."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", name).replace("_", "-").lower()


for _model in (DepthCamera, SpinningLidar, SolidStateLidar, RowLidar):
    register_sensor_model(_model)
