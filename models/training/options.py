"""`TrainingOptions`: the one list of arguments of `coview train` and `python -m models.train`.

The second runs on a machine that has no more than torch, numpy, h5py, safetensors, scipy, shapely
and tqdm, so its parser is made here with the standard library, from the same fields and the same
texts."""

import re
from argparse import ArgumentParser, BooleanOptionalAction
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from models.config import select_anchors

SITE = (
    "Area to train for: tjunction, roundabout, a site file, or general for any place; the data's "
    "when left out."
)


@dataclass(frozen=True, kw_only=True)
class TrainingOptions:
    """Options of a training.

    Attributes:
        data: Packed file made by coview pack.
        out: Folder for checkpoint, log, curves and weights.safetensors.
        start: Shipped weights (such as general, to fit it to your junction) or a file to start
            from.
        preset: fast, general, varied (thinner clouds, uneven ground) or paper; general at site
            general, else fast.
        classes: Classes to detect: vehicle, heavy, cyclist, pedestrian; the classes of
            --start, or vehicle, when left out.
        faces: Classes with boxes measured by a second stage; as in --start when left out.
        calibrate: Fit scores and thresholds on the frames of --validate; implied if --start is
            calibrated.
        size: The light network, or one as wide as the published.
        voxel: Length and width of a voxel (m); 0.2 when left out (the paper has 0.4 at the
            roundabout).
        epochs: Passes over the data; the preset's when left out.
        seconds: Wall time of the training (s) in place of epochs; one cycle of the learning rate
            ends with it.
        batch: Examples per step; the preset's when left out.
        windows: Examples cut from each frame that is read; several are made in less time than as
            many frames.
        learning_rate: Highest learning rate; the preset's when left out.
        seed: Seed of weights, order, noise and augmentation.
        validate: Packed file to measure AP on after each epoch.
        validate_frames: Number of its frames to use.
        device: cpu or cuda; cuda if present when left out.
        bfloat16: Multiply in bfloat16 on the CPU as on cuda: faster on a CPU that supports it, else
            slower.
        threads: Threads of PyTorch; fewer are faster next to other programs.
        workers: Processes that prepare examples.
        checkpoint_s: Seconds between checkpoints.
        overwrite: Replace another training in the folder."""

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
    seconds: float | None = None
    batch: int | None = None
    windows: int = 1
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
        """Raise ValueError for an option that is out of range, and for two that do not fit."""
        # names of options whose value, unless None, must be finite and above 0
        numbers = [
            "voxel",
            "epochs",
            "seconds",
            "learning_rate",
            "batch",
            "windows",
            "validate_frames",
            "threads",
        ]
        for name in [*numbers, "checkpoint_s"]:
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise ValueError(f"{option(name)} must be above 0, got {value}")
        if self.epochs is not None and self.seconds is not None:
            raise ValueError("--epochs and --seconds both end the training: leave one out")
        if self.seed < 0 or self.workers < 0:
            raise ValueError(
                f"--seed and --workers must not be negative, got {self.seed} and {self.workers}"
            )
        # a training that starts from weights keeps their classes, which are not known here
        classes = ("vehicle",) if self.classes is None and self.start is None else self.classes
        if classes is not None:
            select_anchors(classes)  # raises for an unknown class
            if not set(self.faces or ()) <= set(classes):
                raise ValueError(
                    f"--faces must be among --classes {' '.join(classes)}, got "
                    f"{' '.join(self.faces or ())}"
                )
        if self.calibrate and self.validate is None:
            raise ValueError("--calibrate needs frames that were not trained on: give --validate")


def parse_arguments(arguments: Sequence[str] | None = None) -> tuple[str | None, TrainingOptions]:
    """Site (None without one) and options of a command line.

    Prints an error and exits with code 2 for bad arguments. arguments: None for the process's."""
    summary = (TrainingOptions.__doc__ or "").partition("\n")[0]
    parser = ArgumentParser(prog="python -m models.train", description=summary)
    parser.add_argument("site", nargs="?", help=SITE)
    texts = descriptions()
    hints = get_type_hints(TrainingOptions)
    for field in fields(TrainingOptions):
        hint = hints[field.name]
        if get_origin(hint) in (Union, UnionType):
            hint = next(kind for kind in get_args(hint) if kind is not NoneType)
        if hint is bool:
            settings: dict[str, Any] = {"action": BooleanOptionalAction}
        elif get_origin(hint) is tuple:
            settings = {"nargs": "*", "type": get_args(hint)[0]}
        elif get_origin(hint) is Literal:
            settings = {"choices": get_args(hint)}
        else:
            settings = {"type": hint}
        if field.default is not MISSING:
            settings["default"] = field.default
        parser.add_argument(
            option(field.name),
            help=texts[field.name],
            required=field.default is MISSING,
            **settings,
        )
    values = vars(parser.parse_args(arguments))
    site = values.pop("site")
    for name, value in values.items():
        if isinstance(value, list):
            values[name] = tuple(value)
    try:
        return site, TrainingOptions(**values)
    except ValueError as error:
        parser.error(str(error))


def option(name: str) -> str:
    """Name of a field's option on the command line, such as --learning-rate."""
    return "--" + name.replace("_", "-")


def descriptions() -> dict[str, str]:
    """Help text of each field, by its name: its line of `Attributes:` in the class's docstring."""
    return dict(re.findall(r"^ {8}(\w+): (.*)$", TrainingOptions.__doc__ or "", flags=re.MULTILINE))
