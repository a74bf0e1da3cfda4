"""Networks as ONNX files, from coview or others, each with a card, NAME.onnx.json, next to
NAME.onnx.

See docs/how-to/onnx.md. The card is a JSON object with values of `VoxelNetConfig`. Required are
`area`, `labels` and `decoded` (whether the network returns boxes, or maps); `nms_threshold` and the
`sha256` of the file are optional.
"""

import base64
import json
import logging
import warnings
from collections.abc import Iterable, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, SupportsFloat

import numpy as np
import torch
from safetensors.torch import load, save
from torch import Tensor, nn

from models.config import VoxelNetConfig
from models.detector import VoxelNetDetector
from models.detector_loading import relocate, weights_file
from models.network.candidates import candidates
from models.network.faces import FaceNetworks
from models.network.grid import Voxels, voxelise
from models.network.voxelnet import HeightFold, Prediction, VoxelFeatures, VoxelNet
from models.onnx_trial import TrialLimits, try_network
from models.weight_files import load_weights
from toolkit.arrays import Float, Points
from toolkit.objects import Detections
from toolkit.runtime.reading import read_plain, read_text
from toolkit.runtime.text_values import parse_json
from toolkit.runtime.writing import writing
from toolkit.sites.site import PlaceMismatch

MAX_PLACE_M = 1e5  # in boxes that a network returns
MAX_SIZE_M = 100.0  # in boxes that a network returns
MAX_YAW_RAD = 1e3  # in boxes that a network returns
_POINTS = ["points"]  # input of a network that makes its voxels
_VOXELS = ["features", "voxel", "cells"]  # inputs of other networks
_BOXES = ["boxes", "scores", "labels"]  # outputs of a network that decodes its maps
_MISSING = "networks in ONNX need {}: pip install coview[onnx]"


class _Graph(nn.Module):
    """Raw maps of one cloud, by operators that ONNX has."""

    def __init__(self, network: VoxelNet) -> None:
        super().__init__()
        self.network: Any = network

    def forward(self, features: Tensor, voxel: Tensor, cells: Tensor) -> tuple[Tensor, ...]:
        """Raw maps of the network's head, without those that it lacks.

        All points are in one cloud. features: (points, channels); voxel: voxel of each point;
        cells: item (0), ix, iy, iz of each voxel (voxels, 4)."""
        network = self.network
        x = network.features.encode(features, voxel, cells.shape[0])
        if isinstance(network.middle, HeightFold):
            nx, ny, nz = network.middle.shape
            weight = network.middle.weight
            # features times the weights of their voxel's level (0 in the terms of other levels),
            # then summed over its column
            levels = [((cells[:, 3:] == level) * x) @ weight[level] for level in range(nz)]
            x = torch.stack(levels).sum(0)
            # ix * ny + iy
            column = cells[:, 1] * ny + cells[:, 2]
            occupied = x.new_zeros(nx * ny).index_fill(0, column, 1.0)
            # index_add would become ScatterND, whose threads lose summands
            flat = x.new_zeros(nx * ny, x.shape[1])
            x = network.middle.norm(flat.scatter_reduce(0, column[:, None].expand_as(x), x, "sum"))
            x = (torch.relu(x) * occupied[:, None]).view(1, nx, ny, -1).permute(0, 3, 1, 2)
        else:
            x = network.middle(x, Voxels(features, voxel, cells))
        return tuple(raw_map for raw_map in network.head(network.rpn(x)) if raw_map is not None)


def export_onnx(name: str | Path, out: Path, area: Iterable[SupportsFloat] | None = None) -> None:
    """Write shipped weights or a weights file as ONNX, with its card next to it.

    area: xmin ymin xmax ymax (m), for weights that fit any. Raises ImportError without onnxscript,
    ValueError for weights of another area.
    """
    network, header = load_weights(weights_file(name))
    if area is not None:
        xmin, ymin, xmax, ymax = map(float, area)
        network = relocate(network, (xmin, ymin, xmax, ymax), header.site or "general").eval()
    xmin, ymin, xmax, ymax = network.config.area
    points_size = torch.export.Dim("points")
    voxels_size = torch.export.Dim("voxels")
    # any cloud that is large enough: the exporter only follows the operators
    cloud = np.random.default_rng(0).uniform((xmin, ymin, 0), (xmax, ymax, 3), (9000, 3))
    voxels = voxelise(torch.from_numpy(cloud), network.config)
    # axes of the inputs, in the order of `_VOXELS`, that differ from cloud to cloud
    sizes = ({0: points_size}, {0: points_size}, {0: voxels_size})
    for logger_name in ("torch.onnx", "onnx_ir"):
        logging.getLogger(logger_name).setLevel(logging.ERROR)
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # warnings of the exporter
        raw_maps = network(voxels)._asdict()
        export_options: dict[str, Any] = {
            "input_names": _VOXELS,
            "output_names": [name for name, raw_map in raw_maps.items() if raw_map is not None],
            "dynamic_shapes": sizes,
        }
        inputs = (*network.features.inputs(voxels), voxels.cells)
        try:
            import onnxscript  # noqa: F401  # which torch exports with

            program: Any = torch.onnx.export(
                _Graph(network), inputs, dynamo=True, verbose=False, **export_options
            )
        except ImportError as error:
            raise ImportError(_MISSING.format(error.name or "onnxscript")) from None
    proto = program.model_proto
    if network.faces is not None:
        proto.metadata_props.add(
            key="faces", value=base64.b64encode(save(network.faces.state_dict())).decode()
        )
    content = proto.SerializeToString()
    card = {"decoded": False, "sha256": sha256(content).hexdigest(), **network.config.to_dict()}
    write_network(out, content, card)


def _import_runtime() -> Any:
    """ONNX Runtime. Raises ImportError, with the remedy, without it."""
    try:
        import onnxruntime
    except ImportError:
        raise ImportError(_MISSING.format("onnxruntime")) from None
    return onnxruntime


def write_network(out: Path, content: bytes, card: dict[str, Any]) -> None:
    """Write a network and its card, both or none."""
    with writing(out) as network_file, writing(card_file(out)) as unfinished_card:
        network_file.write_bytes(content)
        unfinished_card.write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")


def card_file(path: str | Path) -> Path:
    """Path of the card next to an ONNX file: NAME.onnx.json."""
    return Path(path).with_name(f"{Path(path).name}.json")


def find_card(path: str | Path) -> Path:
    """Path of the present card: NAME.onnx.json, or NAME.json of an earlier coview."""
    earlier = Path(path).with_suffix(".json")
    return earlier if earlier.is_file() and not card_file(path).is_file() else card_file(path)


class OnnxDetector(VoxelNetDetector):
    """Detector of an ONNX file and its card, which computes on the CPU.

    area: xmin ymin xmax ymax (m) of detection, None for the card's; limits: time and memory of the
    first run, in another process. Raises FileNotFoundError without file or card; ValueError, in one
    line, for damaged files, files that do not fit each other or the area, and for a network that
    fails with a cloud or passes the limits; ImportError without onnxruntime."""

    def __init__(
        self,
        path: str | Path,
        area: Iterable[SupportsFloat] | None = None,
        *,
        score_threshold: float | None = None,
        nms_threshold: float | None = None,
        limits: TrialLimits | None = None,
    ) -> None:
        """Read the network and its card, which gives the thresholds that are None.

        area: area that the network must be for, None for its own; limits: memory and time of a
        first trial. Raises FileNotFoundError, and ValueError if both make no detector."""
        card = find_card(path)
        if missing := [str(file) for file in (Path(path), card) if not file.is_file()]:
            needs = "a network in ONNX needs NAME.onnx and its card NAME.onnx.json"
            raise FileNotFoundError(f"no file {missing[0]}: {needs}")
        self._content = read_plain(path)
        self._session = None
        self._weights = sha256(self._content).hexdigest()
        try:
            self._open(parse_json(read_text(card, "JSON")), score_threshold, nms_threshold, limits)
            self.name = str(path)
        except ValueError as error:
            raise ValueError(
                f"{path} and {card.name} make no detector: {' '.join(str(error).split())[:400]}"
            ) from None
        if area is not None and (requested := tuple(float(side) for side in area)) != self.area:
            card_area = " ".join(f"{side:g}" for side in self.area)
            given_area = " ".join(f"{side:g}" for side in requested)
            raise PlaceMismatch(
                f"{path} is for the area {card_area}, got {given_area}: give --area {card_area}, "
                "or export it for yours"
            )

    def _open(
        self,
        card: object,
        score_threshold: float | None,
        nms_threshold: float | None,
        limits: TrialLimits | None,
    ) -> None:
        """Take over the card, and try the network."""
        if not isinstance(card, dict) or not {"decoded", "area", "labels"} <= card.keys():
            raise ValueError(
                f"the card must be an object with decoded, area and labels, got {str(card)[:60]}"
            )
        card = {"nms_threshold": 0.1, "sha256": self._weights, **card}
        self.decoded = card.pop("decoded")
        nms = card.pop("nms_threshold")
        digest = card.pop("sha256")
        if (
            digest != self._weights
            or type(self.decoded) is not bool
            or not isinstance(nms, int | float)
        ):
            got = f"got {self.decoded}, {nms} and {digest}"
            raise ValueError(
                "decoded must be true or false, nms_threshold a number, sha256 the digest of the "
                f"file, {got}"
            )
        config = VoxelNetConfig.from_dict(card)
        self._adopt(config, "cpu", score_threshold, nms if nms_threshold is None else nms_threshold)
        self._tiled = None
        self.faces = None
        self._features = VoxelFeatures(config)
        xmin, ymin, xmax, ymax = config.area
        middle = [(xmin + xmax) / 2, (ymin + ymax) / 2, sum(config.height) / 2]
        trial_cloud = np.array([middle] * 2, np.float32)  # two equal points
        _import_runtime()  # raises if it is missing
        try_network(
            self._content,
            self._points(trial_cloud) | self._voxels(trial_cloud),
            limits or TrialLimits(),
        )
        session = self.session
        input_names = [tensor.name for tensor in session.get_inputs()]
        output_names = [tensor.name for tensor in session.get_outputs()]
        outputs: Sequence[str] = _BOXES
        if not self.decoded:
            outputs = Prediction._fields[: 4 if config.head == "quality" else 2]
        takes_points = sorted(input_names) in (_POINTS, sorted(_VOXELS))
        if not takes_points or not set(output_names) >= set(outputs):
            rule = (
                f"it must take {_POINTS[0]} or {' '.join(_VOXELS)}, and return {' '.join(outputs)}"
            )
            raise ValueError(
                f"{rule}, but takes {' '.join(input_names)} and returns {' '.join(output_names)}"
            )
        if config.faces:
            if (faces := session.get_modelmeta().custom_metadata_map.get("faces")) is None:
                raise ValueError("its metadata lack the networks of the card's faces")
            self.faces = FaceNetworks().eval()
            self.faces.load_state_dict(load(base64.b64decode(faces)))
        self(trial_cloud)  # raises ValueError if its outputs do not fit

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_session": None}

    @property
    def session(self) -> Any:
        """Session of ONNX Runtime, opened once in each process."""
        if self._session is None:
            onnxruntime = _import_runtime()
            options = onnxruntime.SessionOptions()
            level = onnxruntime.GraphOptimizationLevel
            # at the next higher level of optimisation, rounding is three times worse
            options.graph_optimization_level = level.ORT_ENABLE_EXTENDED
            options.intra_op_num_threads = torch.get_num_threads()
            options.log_severity_level = 4
            try:
                self._session = onnxruntime.InferenceSession(
                    self._content, options, ["CPUExecutionProvider"]
                )
            except Exception as error:  # errors of ONNX Runtime share no class
                raise ValueError(f"ONNX Runtime cannot read it ({error})") from None
        return self._session

    def run(self, cloud: Points) -> dict[str, np.ndarray]:
        """Outputs of the network by name. Raises ValueError if it fails.

        cloud: x y z in the network's frame (m)."""
        session = self.session
        points_only = len(session.get_inputs()) == 1
        inputs = self._points(cloud) if points_only else self._voxels(cloud)
        try:
            names = [output.name for output in session.get_outputs()]
            return dict(zip(names, session.run(None, inputs), strict=True))
        except Exception as error:  # errors of ONNX Runtime share no class
            raise ValueError(
                f"{self.name} fails with a cloud of {len(cloud)} points ({error})"
            ) from None

    def _points(self, cloud: Points) -> dict[str, np.ndarray]:
        """Input of a network that takes points."""
        return {_POINTS[0]: np.ascontiguousarray(self._inside(cloud), np.float32)}

    def _voxels(self, cloud: Points) -> dict[str, np.ndarray]:
        """Inputs of a network that takes voxels."""
        voxels = voxelise(cloud, self.config)
        arrays = [tensor.numpy() for tensor in (*self._features.inputs(voxels), voxels.cells)]
        return dict(zip(_VOXELS, arrays, strict=True))

    def _inside(self, cloud: Points) -> Float[np.ndarray, "_ 3"]:
        """Points inside the area and the height range."""
        xmin, ymin, xmax, ymax = self.area
        low, high = self.config.height
        return cloud[((cloud > (xmin, ymin, low)) & (cloud < (xmax, ymax, high))).all(axis=1)]

    def batch(self, clouds: Iterable[np.ndarray]) -> list[Detections]:
        """Detections of each of several clouds, computed one after another."""
        return [
            self._detect(cloud) if len(self._inside(cloud)) else Detections.empty()
            for cloud in clouds
        ]

    def _detect(self, cloud: Points) -> Detections:
        """Detections of one cloud. Raises ValueError if the network's outputs do not fit.

        A network returns either raw maps of its head, or boxes with scores and labels, which are
        indices in `labels`. cloud: x y z in the network's frame (m)."""
        outputs = self.run(cloud)
        if not self.decoded:  # raw maps of the head instead of boxes
            names = [name for name in Prediction._fields if name in outputs]
            maps = Prediction(**{name: torch.from_numpy(outputs[name]) for name in names})
            (best,) = candidates(maps, self.anchors, self.config, self._least_scores)
            return self.finish_detections(best.boxes, best.scores, cloud)
        boxes = outputs["boxes"]
        scores = outputs["scores"]
        labels = outputs["labels"]
        label_count = len(self.labels)
        is_shaped = labels.ndim == 1 and scores.shape == labels.shape
        if (
            not is_shaped
            or boxes.shape != (len(labels), 7)
            or not np.isin(labels, range(label_count)).all()
        ):
            shapes = f"{boxes.shape}, {scores.shape} and {labels.shape}"
            raise ValueError(
                f"{self.name} must return (m, 7), (m,) and (m,), labels below {label_count}, got "
                f"{shapes}"
            )
        self.check_outputs(boxes, scores)
        is_above = scores > np.array(self.thresholds)[labels.astype(int)]
        # one column for each label, 0 for all but the box's label
        is_label = np.eye(label_count)[labels[is_above].astype(int)]
        label_scores = torch.from_numpy(scores[is_above, None] * is_label)
        kept_boxes = torch.from_numpy(boxes[is_above].astype(np.float32))
        return self.finish_detections(kept_boxes, label_scores, cloud)

    def check_outputs(self, boxes: np.ndarray, scores: np.ndarray) -> None:
        """Raise ValueError for scores beyond 0..1, and for boxes that no road user has.

        boxes: x y z length width height yaw (m, 7), in m and rad."""
        is_wrong = ~((scores >= 0) & (scores <= 1))
        if is_wrong.any():
            remedy = "end the network in a sigmoid or softmax"
            raise ValueError(
                f"{self.name}: scores must be within 0..1, got {scores[is_wrong][0]:g}: {remedy}"
            )
        centres = boxes[:, :3]
        sizes = boxes[:, 3:6]
        yaw = boxes[:, 6]
        is_sound = (
            (np.abs(centres) <= MAX_PLACE_M).all(axis=1)
            & (sizes > 0).all(axis=1)
            & (sizes <= MAX_SIZE_M).all(axis=1)
            & (np.abs(yaw) <= MAX_YAW_RAD)
        )
        if not is_sound.all():
            got = " ".join(f"{value:g}" for value in boxes[~is_sound][0])
            limits = (
                f"sizes above 0 up to {MAX_SIZE_M:g} m, within {MAX_PLACE_M:g} m, yaw in radians"
            )
            raise ValueError(
                f"{self.name}: boxes must be x y z length width height yaw with {limits}, got {got}"
            )
