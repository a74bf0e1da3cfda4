"""Files of empty scenes."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from toolkit.calibration.empty_scene import SCENE_IMAGES, EmptyScene, describe_model
from toolkit.runtime.array_files import read_arrays, write_arrays
from toolkit.runtime.text_values import parse_json
from toolkit.sensors.models import make_model


def save_empty_scenes(path: str | Path, scenes: Sequence[EmptyScene]) -> None:
    """Write empty scenes as one .npz file with a checksum.

    It holds JSON with name, model and number of frames of each scene ("scenes"), and the images of
    scene k as "k_NAME"."""
    heads = []
    arrays = {}
    for k, scene in enumerate(scenes):
        model = describe_model(scene.model)
        heads.append({"name": scene.name, "model": model, "frames": scene.frames})
        for image_name in SCENE_IMAGES:
            arrays[f"{k}_{image_name}"] = getattr(scene, image_name)
    write_arrays(path, {"scenes": np.array(json.dumps(heads)), **arrays})


def load_empty_scenes(path: str | Path) -> tuple[EmptyScene, ...]:
    """Read the empty scenes of a file that `save_empty_scenes` wrote.

    Raises FileNotFoundError for a missing file, and ValueError for a damaged file or one without
    empty scenes."""
    arrays = read_arrays(path)
    scenes = []
    try:
        for k, head in enumerate(parse_json(str(arrays["scenes"]))):
            model_values = dict(head["model"])
            class_name = model_values.pop("class")  # the other values are the model's fields
            model = make_model(class_name, model_values)
            images = {name: arrays[f"{k}_{name}"] for name in SCENE_IMAGES}
            scenes.append(EmptyScene(head["name"], model, frames=head["frames"], **images))
        return tuple(scenes)
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(
            f"{path} has no empty scenes ({error}): write them with save_empty_scenes"
        ) from None
