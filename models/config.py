"""`VoxelNetConfig`: the shape and meaning of a network."""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any, Literal, SupportsFloat

from models.anchor_kind import AnchorKind
from toolkit.objects import LABELS

MAX_COLUMNS = 5_000_000  # in the grid, with maps of some 300 bytes per column
MAX_HEIGHT_CELLS = 500
MAX_MAP_ANCHORS = 16_000_000
MAX_WIDTH = 4096  # channels of a layer
MAX_LAYERS = 64  # in a block
MAX_VOXEL_POINTS = 10_000
_MAX_VALUE = 1e6  # absolute value of a number in a configuration
_LENGTHS = {"area": 4, "height": 2, "voxel_size": 3, "anchor_size": 3, "size": 3}
SHIPPED = Path(__file__).parent / "weights"
SITE_AREAS = {"tjunction": (-40.0, -20.0, 40.0, 20.0), "roundabout": (-48.0, -48.0, 48.0, 48.0)}
_LIGHT: dict[str, Any] = {
    "point_features": "local",
    "vfe_widths": (),
    "voxel_width": 32,
    "middle_widths": (),
    "column_width": 32,
    "rpn_widths": (48, 80, 96),
    "rpn_layers": ((0, 1), (0, 1, 2), (0, 1, 2)),
    "upsample": "add",
    "upsample_width": 64,
    "head3x3": 0,
    "head": "quality",
    "anchor_z": 0.8,
    "quality_power": 1.0,
    "averaging": 0.75,
}
_VOXEL_SIZES = {"tjunction": (0.2, 0.2, 0.4), "roundabout": (0.4, 0.4, 0.4)}
# entries that calibration fits
FITTED = ("calibration", "rivalry", "known", "thresholds", "known_thresholds", "rival_shares")
ROAD_USERS = (
    AnchorKind("vehicle", size=(3.9, 1.56, 1.6), z=0.8),
    AnchorKind("heavy", size=(9.0, 2.5, 3.2), z=1.6, positive=0.45, negative=0.3),
    AnchorKind("cyclist", size=(1.8, 0.65, 1.65), z=0.85, margin=0.6),
    AnchorKind("pedestrian", size=(0.65, 0.6, 1.7), z=0.85, yaws=(0.0,), margin=0.8),
)
"""Classes of a network for all road users; vehicle has the anchors of networks for vehicles
only."""


@dataclass(frozen=True)
class VoxelNetConfig:
    """Grid, widths and head of one VoxelNet; the published network by default.

    The grid starts at the lower corner of the area and may extend beyond its upper end, since its
    size is a multiple of the network's stride, but points outside the area are ignored. Maps have H
    along x, W along y. Raises ValueError for impossible values.
    """

    area: tuple[float, float, float, float]  # xmin ymin xmax ymax, m
    height: tuple[float, float] = (0.0, 4.0)  # m
    voxel_size: tuple[float, float, float] = (0.2, 0.2, 0.4)  # m
    max_points: int = 35  # T of the paper: a voxel's points beyond it are dropped at random

    point_features: Literal["published", "local"] = "published"
    """published: absolute coordinates, and the zeros that pad a voxel to T points take part in its
    maximum; local: coordinates from the voxel's centre (z: from the ground), no padding, so that
    any area looks alike."""
    vfe_widths: tuple[int, ...] = (16,)  # each is doubled by appending the voxel's maximum
    voxel_width: int = 128
    # 3D convolutions; () folds the height into `column_width` channels
    middle_widths: tuple[int, ...] = (64, 64, 64)
    column_width: int = 0

    rpn_widths: tuple[int, int, int] = (128, 128, 256)
    rpn_layers: tuple[tuple[int, ...], ...] = ((0, 1, 2, 3), (0, 1, 1, 2, 3, 4), (0, 1, 2, 2, 3, 4))
    """The order in which each block applies its convolutions: the published one applies one of
    blocks 2 and 3 twice."""
    upsample: Literal["concatenate", "add"] = "concatenate"
    """concatenate: as published, three linear maps side by side; add: their sum, normalised and
    rectified."""
    upsample_width: int = 256
    head3x3: int = 512  # width of the head's 3x3 convolution; 0: none

    head: Literal["published", "quality"] = "published"
    """published: softmax over background and vehicle, seven residuals with the plain yaw
    difference; quality: a logit per label, eight residuals with the doubled angle, a direction
    logit, an IoU logit."""
    labels: tuple[str, ...] = ("vehicle",)
    anchor_size: tuple[float, float, float] = (3.9, 1.56, 1.6)  # length width height, m
    anchor_z: float = 1.6  # height of the anchors' centres, m
    anchor_yaws: tuple[float, ...] = (0.0, math.pi / 2)
    quality_power: float = 0.0  # score = class probability · (predicted IoU)^quality_power
    averaging: float = 0.0
    """Above 0: a box is the mean of all candidates whose footprints overlap it by a larger IoU."""

    kinds: tuple[AnchorKind, ...] = ()
    """Anchors by class, in the order of `labels`; (): all anchors are `anchor_size` and have a
    logit for every label, which can be trained for one label only."""
    faces: tuple[str, ...] = ()  # labels whose boxes' faces are measured by `models.network.faces`
    calibration: tuple[tuple[float, float], ...] = ()
    """Per label a slope and an intercept: score = sigmoid(slope · logit(score) + intercept); (): as
    they are."""
    rivalry: tuple[tuple[float, ...], ...] = ()
    """Per label a slope, an intercept and a weight for each label, which lower scores of boxes that
    overlap boxes of other labels (`models.network.candidates`); (): as they are."""
    known: tuple[tuple[float, ...], ...] = ()
    """As `rivalry`, for the scores that remain if the detector knows the empty site."""
    score_threshold: float = 0.1  # used if the caller gives none
    thresholds: tuple[float, ...] = ()  # the same by label; (): `score_threshold` for all
    known_thresholds: tuple[float, ...] = ()  # the same of `known` scores; (): `thresholds`
    rival_shares: tuple[float, ...] = ()
    """Per label a share of a rival's score; boxes with less are dropped. (): `LARGE_RIVAL_SHARES`
    of `models.network.candidates`, between vehicles and heavy ones; zeros: no box is dropped."""

    def __post_init__(self) -> None:
        """Raise ValueError for a field that is out of range, and for fields that do not fit."""
        xmin, ymin, xmax, ymax = self.area
        if not (xmax > xmin and ymax > ymin and self.height[1] > self.height[0]):
            raise ValueError(f"area and height must ascend, got {self.area} and {self.height}")
        if min(self.voxel_size) <= 0 or self.max_points < 1:
            raise ValueError(
                f"voxels need a size above 0 and points, got {self.voxel_size} and "
                f"{self.max_points}"
            )
        if bool(self.middle_widths) == bool(self.column_width):
            values = f"got middle_widths {self.middle_widths} and column_width {self.column_width}"
            raise ValueError(f"give either three middle_widths or a column_width, {values}")
        if (
            len(self.middle_widths) not in (0, 3)
            or len(self.rpn_widths) != 3
            or len(self.rpn_layers) != 3
        ):
            raise ValueError(
                "middle_widths (unless empty), rpn_widths and rpn_layers need three entries each"
            )
        self._check_sizes()
        self._check_labels()
        self._check_calibration()

    def _check_labels(self) -> None:
        """Raise ValueError unless labels, faces and anchor kinds fit each other."""
        unknown_names = [name for name in (*self.labels, *self.faces) if name not in LABELS]
        if unknown_names or len(set(self.labels)) != len(self.labels) or not self.labels:
            raise ValueError(
                f"labels must be different ones of {LABELS}, got {self.labels} with faces "
                f"{self.faces}"
            )
        if self.kinds and (
            self.head != "quality" or tuple(kind.label for kind in self.kinds) != self.labels
        ):
            values = (
                f"got labels {self.labels}, kinds {[kind.label for kind in self.kinds]} and head "
                f"{self.head!r}"
            )
            raise ValueError(
                "anchors by class need a quality head and a kind for each label in its order, "
                f"{values}"
            )
        if not set(self.faces) <= set(self.labels):
            raise ValueError(f"faces must be among the labels, got {self.faces} and {self.labels}")

    def _check_calibration(self) -> None:
        """Raise ValueError unless calibration and thresholds are empty or fit the labels."""
        size = len(self.labels)
        # numbers in a row of each field: slope and intercept; the last two fields add a weight for
        # each label
        lengths = {"calibration": 2, "rivalry": size + 2, "known": size + 2}
        for name, length in lengths.items():
            rows = getattr(self, name)
            invalid_rows = [
                row
                for row in rows
                if len(row) != length or row[0] <= 0 or min(row[2:], default=0) < 0
            ]
            if len(rows) not in (0, size) or invalid_rows:
                needs = (
                    "a slope above 0, an intercept"
                    + " and a weight of at least 0 for each label" * (length > 2)
                )
                raise ValueError(
                    f"{name} must have {needs}, for each label, or be empty, got {rows}"
                )
        by_label = self.thresholds, self.known_thresholds, self.rival_shares
        shares = [self.score_threshold]
        for row in by_label:
            shares += row
        if not all(0 <= share < 1 for share in shares):
            raise ValueError(
                f"thresholds and rival_shares must be within 0..1, got {self.score_threshold}, "
                f"{by_label}"
            )
        if not set(map(len, by_label)) <= {0, size}:
            raise ValueError(
                f"thresholds must be one per label or empty, got {by_label} for {self.labels}"
            )

    def _check_sizes(self) -> None:
        """Raise ValueError for a network that would take far too much memory."""
        nx, ny, nz = self.grid_shape
        sides = " ".join(f"{side:g}" for side in self.area)
        if nx * ny > MAX_COLUMNS or nz > MAX_HEIGHT_CELLS:
            got = f"area {sides} and voxel_size {self.voxel_size} make {nx} x {ny} x {nz} voxels"
            rule = f"at most {MAX_COLUMNS} columns of {MAX_HEIGHT_CELLS}"
            raise ValueError(
                f"the grid must have {rule}, but {got}: lower the area or raise voxel_size"
            )
        yaws = sum(len(kind.yaws) for kind in self.kinds) or len(self.anchor_yaws)
        anchors = nx * ny // 4 * yaws  # the head's map has half as many cells along x and y
        if anchors > MAX_MAP_ANCHORS:
            raise ValueError(
                f"there may be {MAX_MAP_ANCHORS} anchors, got {anchors}: lower the area or "
                "anchor_yaws"
            )
        layers = (self.vfe_widths, *self.rpn_layers)
        widths = (*self.vfe_widths, *self.middle_widths, *self.rpn_widths)
        widths = (*widths, self.voxel_width, self.column_width, self.upsample_width, self.head3x3)
        if not all(0 <= width <= MAX_WIDTH for width in widths) or 0 in (
            *self.rpn_widths,
            self.voxel_width,
        ):
            raise ValueError(
                f"widths of layers must be at most {MAX_WIDTH}, got {max(widths)} and {min(widths)}"
            )
        orders = [number for order in self.rpn_layers for number in order]
        if max(map(len, layers)) > MAX_LAYERS or not all(
            0 <= number < MAX_LAYERS for number in orders
        ):
            raise ValueError(
                f"a block has at most {MAX_LAYERS} layers, numbered from 0, got "
                f"{str(self.rpn_layers)[:60]}"
            )
        if self.max_points > MAX_VOXEL_POINTS:
            raise ValueError(
                f"max_points must be at most {MAX_VOXEL_POINTS}, got {self.max_points}"
            )

    @classmethod
    def from_paper(cls, site: str, **changes: Any) -> "VoxelNetConfig":
        """Return the paper's network for "tjunction" or "roundabout", in the site's frame."""
        if site not in SITE_AREAS:
            raise ValueError(
                f"the published networks are for {' and '.join(SITE_AREAS)}, got {site!r}"
            )
        return cls(**{"area": SITE_AREAS[site], "voxel_size": _VOXEL_SIZES[site], **changes})

    @classmethod
    def light(cls, area: Iterable[SupportsFloat], **changes: Any) -> "VoxelNetConfig":
        """Return the CPU default for any area: a quarter of the width, no 3x3 head."""
        return cls(**{"area": tuple(float(side) for side in area), **_LIGHT, **changes})

    @property
    def grid_shape(self) -> tuple[int, int, int]:
        """Voxels along x, y and z. x and y are multiples of 8, the stride of the third block."""
        # rounded to 6 digits, as 4.2 / 0.6 comes out just above 7; -(-n // 8) * 8 rounds n up
        xmin, ymin, xmax, ymax = self.area
        nx = math.ceil(round((xmax - xmin) / self.voxel_size[0], 6))
        ny = math.ceil(round((ymax - ymin) / self.voxel_size[1], 6))
        nz = math.ceil(round((self.height[1] - self.height[0]) / self.voxel_size[2], 6))
        return -(-nx // 8) * 8, -(-ny // 8) * 8, nz

    @property
    def map_shape(self) -> tuple[int, int]:
        """Rows (along x) and columns (along y) of the head's maps."""
        return self.grid_shape[0] // 2, self.grid_shape[1] // 2

    @property
    def stride(self) -> tuple[float, float]:
        """Metres between neighbouring anchors along x and y."""
        return 2 * self.voxel_size[0], 2 * self.voxel_size[1]

    @property
    def anchor_kinds(self) -> tuple[AnchorKind, ...]:
        """Anchors of a cell, class by class: `kinds`, or the one kind that the other entries
        describe."""
        return self.kinds or (
            AnchorKind(
                label=self.labels[0], size=self.anchor_size, z=self.anchor_z, yaws=self.anchor_yaws
            ),
        )

    @property
    def anchor_labels(self) -> tuple[int, ...]:
        """Row in `anchor_kinds` of each anchor of a cell."""
        return tuple(row for row, kind in enumerate(self.anchor_kinds) for _ in kind.yaws)

    @property
    def classes(self) -> int:
        """Class logits per anchor: one or one per label, and a published head's background."""
        return (1 if self.kinds else len(self.labels)) + (self.head == "published")

    @property
    def residuals(self) -> int:
        """Box residuals per anchor."""
        return 7 if self.head == "published" else 8

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        # Entries younger than the first shipped weights are left out at their default, so that
        # digests do not change.
        new_names = ("kinds", "faces", "score_threshold", *FITTED)
        defaults = {field.name: field.default for field in fields(self) if field.name in new_names}
        return {
            name: value
            for name, value in asdict(self).items()
            if name not in new_names or value != defaults[name]
        }

    @classmethod
    def from_dict(cls, values: object) -> "VoxelNetConfig":
        """Configuration from `to_dict`'s values as JSON returns them. Raises ValueError for
        others."""
        example = _make_example()
        if not isinstance(values, dict):
            raise ValueError(
                f"a VoxelNetConfig must be an object of names and values, got {str(values)[:60]}"
            )
        if unknown := values.keys() - example:
            raise ValueError(
                f"a VoxelNetConfig has no {', '.join(sorted(unknown))}: is the file newer?"
            )
        if "area" not in values:
            raise ValueError("a VoxelNetConfig needs an area: xmin ymin xmax ymax (m)")
        kinds = values.get("kinds", ())
        anchor = asdict(ROAD_USERS[0])
        if not isinstance(kinds, list | tuple):
            raise ValueError(f"kinds must be a list of anchors, got {str(kinds)[:60]}")
        for kind in kinds:
            if (
                not isinstance(kind, dict)
                or not {"label", "size", "z"} <= kind.keys() <= anchor.keys()
            ):
                raise ValueError(
                    f"an entry of kinds must be an object of {', '.join(anchor)}, got "
                    f"{str(kind)[:60]}"
                )
        parsed_values = {
            name: _parse(value, example[name], name)
            for name, value in values.items()
            if name != "kinds"
        }
        anchor_kinds = []
        for kind in kinds:
            entries = {name: _parse(value, anchor[name], name) for name, value in kind.items()}
            anchor_kinds.append(AnchorKind(**entries))
        return cls(**parsed_values, kinds=tuple(anchor_kinds))


def road_users(kinds: tuple[AnchorKind, ...] = ROAD_USERS) -> dict[str, Any]:
    """Entries of a configuration for these classes."""
    return {"kinds": kinds, "labels": tuple(kind.label for kind in kinds)}


def select_anchors(labels: Iterable[str]) -> tuple[AnchorKind, ...]:
    """Anchors of `ROAD_USERS` in the order of `labels`. Raises ValueError for other labels."""
    by_label = {kind.label: kind for kind in ROAD_USERS}
    labels = tuple(labels)
    if not labels or not set(labels) <= set(by_label) or len(set(labels)) != len(labels):
        raise ValueError(
            f"classes must be different ones of {', '.join(by_label)}, got "
            f"{', '.join(labels) or 'none'}"
        )
    return tuple(by_label[label] for label in labels)


@cache
def _make_example() -> dict[str, Any]:
    """Return a configuration in which no entry is empty, from which their types can be read."""
    example = VoxelNetConfig(
        (0.0, 0.0, 1.0, 1.0),
        faces=("vehicle",),
        calibration=((1.0, 0.0),),
        rivalry=((1.0, 0.0, 0.0),),
        known=((1.0, 0.0, 0.0),),
        thresholds=(0.1,),
        known_thresholds=(0.1,),
        rival_shares=(0.1,),
    )
    return asdict(example)


def _parse(value: Any, example: Any, name: str) -> Any:
    """Value with its lists as tuples. Raises ValueError unless it has the type of the example.

    example: value of the same entry, or of the first of a list's entries. name: the entry's.
    """
    got = str(value)[:60]
    match example:
        case tuple():
            if not isinstance(value, list | tuple):
                raise ValueError(f"{name} must be a list like {example}, got {got}")
            if name in _LENGTHS and len(value) != _LENGTHS[name]:
                raise ValueError(f"{name} must have {_LENGTHS[name]} entries, got {len(value)}")
            return tuple(_parse(entry, example[0], name) for entry in value)
        case str() if not isinstance(value, str):
            raise ValueError(f"{name} must be a text like {example!r}, got {got}")
        case int() | float():
            if isinstance(value, bool) or not isinstance(
                value, int if isinstance(example, int) else int | float
            ):
                raise ValueError(f"{name} must be a number like {example}, got {got}")
            if not -_MAX_VALUE <= value <= _MAX_VALUE:
                raise ValueError(f"{name} must be within ±{_MAX_VALUE:g}, got {got}")
    return value
