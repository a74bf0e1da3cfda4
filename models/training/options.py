"""`TrainingOptions`: the one list of a training's arguments, for `coview train` and for `python -m models.train`.

The second runs on a machine that has no more than torch, numpy, h5py, safetensors, scipy, shapely and tqdm, so its
parser is made here with the standard library, from the same fields and the same texts.
"""

from __future__ import annotations

import re
from argparse import ArgumentParser, BooleanOptionalAction
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from models.config import select_anchors

SITE = """Gives the area: tjunction, roundabout, a site file; or general, for a network that works anywhere; left out,
the area that all of the data shares."""


@dataclass(frozen=True, kw_only=True)
class TrainingOptions:
    """How a network is trained, from what, and where it goes.

    Attributes:
        data: Made by coview pack.
        out: Folder for checkpoint, log, curves and weights.safetensors.
        start: Weights to go on from, a shipped name (general, to fit it to your junction) or a file, instead of random.
        preset: fast, or general for general, when left out; varied: thinner clouds, uneven ground; paper: as published.
        classes: What it detects, of vehicle, heavy, cyclist, pedestrian; when left out, what --start does, or vehicle.
        faces: Classes whose boxes' faces a second stage measures; when left out, those of --start.
        calibrate: Choose scores and thresholds on the frames of --validate; done as well where those of --start were.
        size: The light network, or one as wide as the published.
        voxel: Length and width of a voxel (m); 0.2 when left out (the paper has 0.4 at the roundabout).
        epochs: Passes over the data; the preset's when left out.
        batch: Frames per step; the preset's when left out.
        learning_rate: The highest; the preset's when left out.
        seed: Of weights, order, noise and augmentation.
        validate: Packed file to measure AP on after each epoch.
        validate_frames: Only its first so many.
        device: cpu or cuda; cuda where there is one when left out.
        bfloat16: Multiply in bfloat16 on the CPU too, as on cuda: faster on a CPU that knows it, else slower.
        threads: Of PyTorch; with other programs on the machine, fewer are faster.
        workers: Processes that prepare examples.
        checkpoint_s: Seconds between checkpoints.
        overwrite: Begin anew in a folder that holds another training.
    """

    data: Path
    out: Path
    start: str | None = None
    preset: Literal["fast", "paper", "general", "varied"] | None = None
    classes: tuple[str, ...] | None = None
    faces: tuple[str, ...] | None = None
    calibrate: bool = False
    size: Literal["light", "published"] = "light"
    voxel: float | None = None
    epochs: float | None = None
    batch: int | None = None
    learning_rate: float | None = None
    seed: int = 0
    validate: Path | None = None
    validate_frames: int | None = 200
    device: str | None = None
    bfloat16: bool = False
    threads: int | None = None
    workers: int = 0
    checkpoint_s: float = 300.0
    overwrite: bool = False

    def __post_init__(self) -> None:
        for name in ("voxel", "epochs", "learning_rate", "batch", "validate_frames", "threads", "checkpoint_s"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise ValueError(f"{option(name)} must be above 0, got {value}")
        if self.seed < 0 or self.workers < 0:
            raise ValueError(f"--seed and --workers must not be negative, got {self.seed} and {self.workers}")
        known = ("vehicle",) if self.classes is None and self.start is None else self.classes
        if known is not None:
            select_anchors(known)
            if not set(self.faces or ()) <= set(known):
                raise ValueError(f"--faces must be among --classes {' '.join(known)}, got {' '.join(self.faces or ())}")
        if self.calibrate and self.validate is None:
            raise ValueError("--calibrate needs frames that were not trained on: give --validate")


def parse_arguments(arguments: Sequence[str] | None = None) -> tuple[str | None, TrainingOptions]:
    """Parse site and options of a command line.

    Prints an error and exits with code 2 for bad arguments.
    """
    parser = ArgumentParser(prog="python -m models.train", description=TrainingOptions.__doc__.partition("\n")[0])  # type: ignore[union-attr]
    parser.add_argument("site", nargs="?", help=SITE)
    texts, hints = descriptions(), get_type_hints(TrainingOptions)
    for each in fields(TrainingOptions):
        settings = _argument(hints[each.name])
        needed = each.default is MISSING
        if not needed:
            settings["default"] = each.default
        parser.add_argument(option(each.name), help=texts[each.name], required=needed, **settings)
    values = vars(parser.parse_args(arguments))
    site = values.pop("site")
    values = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
    try:
        return site, TrainingOptions(**values)
    except ValueError as error:
        parser.error(str(error))


def option(name: str) -> str:
    """Name of a field on the command line.

    >>> option("learning_rate")
    '--learning-rate'
    """
    return "--" + name.replace("_", "-")


def descriptions() -> dict[str, str]:
    """Help text of each field."""
    return dict(re.findall(r"^ {8}(\w+): (.*)$", TrainingOptions.__doc__ or "", flags=re.MULTILINE))


def _argument(hint: Any) -> dict[str, Any]:
    """Settings for argparse of a type."""
    if get_origin(hint) in (Union, UnionType):
        hint = next(each for each in get_args(hint) if each is not NoneType)
    if hint is bool:
        return {"action": BooleanOptionalAction}
    if get_origin(hint) is tuple:
        return {"nargs": "*", "type": get_args(hint)[0]}
    if get_origin(hint) is Literal:
        return {"choices": get_args(hint)}
    return {"type": hint}
