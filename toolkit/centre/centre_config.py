"""Configuration of a running centre, in TOML.

coview_run = 1                  # version of this format
detector = "general"            # as in coview detect
detect_every = 2                # in every second frame; 1 when left out
parallel = 2                    # frames in which it detects at the same time; 1 when left out
deadline_s = 0.08               # from a frame's last point; 10 to wait for its detection

[[input]]                       # one recording or junction, or several lidars
kind = "recording"              # replayed at its pace
path = "street.hdf5"            # relative paths count from this file
layout = "hdf5"                 # guessed when left out; poses = "poses.json" for layout folder
errors = "paper"                # noise of simulated sensors

[[input]]
kind = "junction"               # simulated in real time
site = "tjunction"              # name or file of a site with sensors
seconds = 600                   # how long it runs
seed = 0

[[input]]
kind = "velodyne"               # packets by UDP
name = "north"
port = 2368
address = "192.168.1.201"       # address of the lidar, any when left out

[[input]]
kind = "ouster"                 # packets by UDP, next to other lidars
name = "south"
metadata = "south.json"         # of the sensor, as ouster-cli saves it
port = 7502                     # address = as above

[replay]
speed = 1                       # seconds of the recording in a second
interval_s = 0.1                # from a sensor's measurement to its next; known from recordings

[[sensor]]                      # what the input does not know of a sensor, or knows wrongly
name = "north"
pose = [[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 6]]   # world_SE3_sensor, forms of pose files
clock_offset_s = 0              # by which its clock is ahead
background = "scenes.npz"       # empty scene, see toolkit.calibration.scene_files

[place]                         # as in coview detect
level = "map"
area = [-40, -40, 40, 40]

[output]
folder = "out"                  # out/mcap/000000.mcap, ...
to = ["mcap", "kitti-tracking"]
piece_s = 60                    # time of a file
clouds = false                  # write clouds, too, in formats that hold them
origin = [48.137, 11.575]       # latitude and longitude of 0 0 0, for mf-json and cpm
asn1 = "asn1"                   # folder of ETSI's ASN.1 modules, for cpm

[page]
port = 8080

[health]
file = "health.jsonl"
every_s = 10
"""

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, cast

from toolkit.calibration.place import LEVELS, Level, Place
from toolkit.centre.detection_pool import DEADLINE_S
from toolkit.centre.health import HEALTH_EVERY_S
from toolkit.centre.sensor_message import SensorSetup
from toolkit.datasets.pose_files import parse_pose
from toolkit.exchange.geo_origin import GeoOrigin
from toolkit.exchange.pieces import PieceWriter
from toolkit.exchange.standards import STANDARDS
from toolkit.runtime.json_object import JsonObject
from toolkit.runtime.reading import name_errors, read_bytes
from toolkit.runtime.text_values import parse_toml

CONFIG_VERSION = 1
PIECE_S = 60.0
MAX_EVERY = 10  # frames from one that is detected to the next
MAX_PARALLEL = 16
MAX_DEADLINE_S = 10.0  # frames that wait are in memory
_MAX_ROWS = 64  # inputs or sensors
_MAX_SPEED = 1000.0
_MAX_S = 1e7
InputKind = Literal["recording", "junction", "velodyne", "ouster"]
_TABLES = ("input", "replay", "sensor", "place", "output", "page", "health")
_KEYS = ("coview_run", "detector", "detect_every", "parallel", "deadline_s", *_TABLES)
_OUTPUT_KEYS = ("folder", "to", "piece_s", "origin", "asn1", "clouds")
_INPUT_KEYS: dict[str, tuple[str, ...]] = {
    "recording": ("path", "layout", "poses", "errors", "site"),
    "junction": ("site", "seconds", "seed"),
    "velodyne": ("name", "port", "address"),
    "ouster": ("name", "metadata", "port", "address"),
}
_LIDAR_PORTS = {"velodyne": 2368, "ouster": 7502}  # usual UDP ports by kind of lidar


@dataclass(frozen=True)
class InputConfig:
    """One input, of which only the fields of its kind count.

    Attributes:
        kind: Recording, junction, velodyne or ouster.
        path: File or folder of a recording.
        layout: Its layout, None to guess it.
        poses: File of its sensors' poses, None for the poses in the recording.
        errors: Error profile of simulated sensors.
        site: Name or file of a site, "" for none.
        seconds: Time that a junction runs.
        seed: Seed of its traffic and noise.
        name: Name of a lidar.
        port: UDP port to which it sends.
        address: Address of the lidar, None for any.
        metadata: File of an Ouster's metadata, None for other kinds.
    """

    kind: InputKind
    path: Path = Path()
    layout: str | None = None
    poses: Path | None = None
    errors: str = "paper"
    site: str = ""
    seconds: float = 600.0
    seed: int = 0
    name: str = ""
    port: int = 0
    address: str | None = None
    metadata: Path | None = None


@dataclass(frozen=True)
class OutputConfig:
    """Files of tracks.

    Attributes:
        folders: Folder of each format by its name.
        piece_s: Time of a file (s).
        origin: Place on earth of the world's 0 0 0, None if unknown.
        asn1: Folder of the ASN.1 modules for cpm.
        clouds: True to write clouds, too, in formats that hold them.
    """

    folders: dict[str, Path] = field(default_factory=dict)
    piece_s: float = PIECE_S
    origin: GeoOrigin | None = None
    asn1: Path | None = None
    clouds: bool = False

    def make_writer(self) -> PieceWriter:
        """Make the writer of the files. Raises the errors of `PieceWriter`."""
        return PieceWriter(self.folders, piece_s=self.piece_s, origin=self.origin, asn1=self.asn1)


@dataclass(frozen=True)
class CentreConfig:
    """Configuration of a centre.

    Attributes:
        inputs: Sources of messages.
        detector: Name of the detector, with its suffixes.
        detect_every: 2 to detect in every second frame, and so on.
        parallel: Number of frames in which it detects at the same time.
        deadline_s: Longest wait for detections, from a frame's last point (s).
        setups: Poses and clock offsets by sensor.
        backgrounds: Files of empty scenes by sensor.
        place: Area and ground.
        speed: Seconds of a replay in a second.
        interval_s: Time from a sensor's measurement to its next, None if the input knows it.
        output: Files of tracks.
        page_port: Port of the live page, None for no page.
        health_file: File of health lines, None for none.
        health_every_s: Time between two health lines (s).
    """

    inputs: tuple[InputConfig, ...]
    detector: str = "general"
    detect_every: int = 1
    parallel: int = 1
    deadline_s: float = DEADLINE_S
    setups: dict[str, SensorSetup] = field(default_factory=dict)
    backgrounds: dict[str, Path] = field(default_factory=dict)
    place: Place = field(default_factory=lambda: Place(still=True))
    speed: float = 1.0
    interval_s: float | None = None
    output: OutputConfig = field(default_factory=OutputConfig)
    page_port: int | None = None
    health_file: Path | None = None
    health_every_s: float = HEALTH_EVERY_S


def load_centre_config(path: str | Path) -> CentreConfig:
    """Load the configuration of a centre.

    Raises OSError, and ValueError in one line that names the wrong entry."""
    content = read_bytes(path)
    with name_errors(path):
        return _parse_config(JsonObject(parse_toml(content)), Path(path).parent)


def _parse_config(document: JsonObject, folder: Path) -> CentreConfig:
    """Parse a document; folder: the one from which its relative paths count."""
    version = document.whole("coview_run", low=1, high=10**6)
    if version != CONFIG_VERSION:
        raise ValueError(
            f"coview_run {version} is of another coview: this one reads {CONFIG_VERSION}"
        )
    document.check_keys(_KEYS)
    inputs = tuple(_parse_input(row, folder) for row in document.nodes("input", _MAX_ROWS))
    _check_inputs(inputs)
    rows = list(document.nodes("sensor", _MAX_ROWS)) if "sensor" in document.value else []
    sensors = _name_rows(rows)
    replay = _take_table(document, "replay", ("speed", "interval_s"))
    health = _take_table(document, "health", ("file", "every_s"))
    page = _take_table(document, "page", ("port",))
    return CentreConfig(
        inputs,
        detector=_take(document, "detector", str, "general"),
        detect_every=_take_count(document, "detect_every", MAX_EVERY),
        parallel=_take_count(document, "parallel", MAX_PARALLEL),
        deadline_s=_take_number(document, "deadline_s", DEADLINE_S, (0.0, MAX_DEADLINE_S)),
        setups={name: _parse_setup(row) for name, row in sensors.items()},
        backgrounds={
            name: folder / row.get("background", str)
            for name, row in sensors.items()
            if "background" in row.value
        },
        place=_parse_place(document),
        speed=_take_number(replay, "speed", default=1.0, limits=(1e-3, _MAX_SPEED)),
        interval_s=_take_number(replay, "interval_s", default=None, limits=(0.01, 10.0)),
        output=_parse_output(document, folder),
        page_port=page.whole("port", low=1, high=2**16 - 1) if page.value else None,
        health_file=folder / health.get("file", str) if "file" in health.value else None,
        health_every_s=_take_number(health, "every_s", HEALTH_EVERY_S, (0.1, _MAX_S)),
    )


def _parse_input(row: JsonObject, folder: Path) -> InputConfig:
    """Parse an input, whose keys depend on its kind; relative paths count from `folder`."""
    kind = cast(InputKind, row.choice("kind", _INPUT_KEYS))
    row.check_keys(("kind", *_INPUT_KEYS[kind]))
    if kind == "recording":
        has_poses = "poses" in row.value
        return InputConfig(
            kind,
            path=folder / row.get("path", str),
            layout=_take(row, "layout", str, default=None),
            poses=folder / row.get("poses", str) if has_poses else None,
            errors=_take(row, "errors", str, "paper"),
            site=_find_site(row, folder),
        )
    if kind == "junction":
        row.get("site", str)  # raises without one
        return InputConfig(
            kind,
            site=_find_site(row, folder),
            seconds=_take_number(row, "seconds", default=600.0, limits=(1.0, _MAX_S)),
            seed=row.whole("seed", low=0, high=2**31) if "seed" in row.value else 0,
        )
    return InputConfig(
        kind,
        name=row.get("name", str),
        port=row.whole("port", low=1, high=2**16 - 1)
        if "port" in row.value
        else _LIDAR_PORTS[kind],
        address=_take(row, "address", str, default=None),
        metadata=folder / row.get("metadata", str) if kind == "ouster" else None,
    )


def _find_site(row: JsonObject, folder: Path) -> str:
    """Return the site of an input: a file next to the configuration, or a name; "" for none."""
    site: str = _take(row, "site", str, "")
    return str(folder / site) if site and (folder / site).is_file() else site


def _check_inputs(inputs: tuple[InputConfig, ...]) -> None:
    """Raise ValueError for no input, and for a recording or junction next to another input."""
    if not inputs:
        raise ValueError("input must be a list of at least one input: begin it with [[input]]")
    kinds = [source.kind for source in inputs]
    if len(inputs) > 1 and not _LIDAR_PORTS.keys() >= set(kinds):
        raise ValueError(
            f"a recording or junction sets the clock, got inputs {', '.join(kinds)}: give "
            "one of them, or several lidars"
        )


def _name_rows(rows: list[JsonObject]) -> dict[str, JsonObject]:
    """Return the sensors' tables by name. Raises ValueError for a name that is there twice."""
    sensors: dict[str, JsonObject] = {}
    for row in rows:
        row.check_keys(("name", "pose", "clock_offset_s", "background"))
        name = row.get("name", str)
        if name in sensors:
            raise ValueError(f"{row.where('name')} {name!r} is there twice: leave one out")
        sensors[name] = row
    return sensors


def _parse_setup(row: JsonObject) -> SensorSetup:
    """Parse pose and clock offset of a sensor."""
    pose = None
    if "pose" in row.value:
        pose = parse_pose(row.get("pose", list), row.where("pose"))
    return SensorSetup(
        pose, _take_number(row, "clock_offset_s", default=0.0, limits=(-3600.0, 3600.0))
    )


def _parse_place(document: JsonObject) -> Place:
    """Parse area and ground; sensors of a centre do not move."""
    table = _take_table(document, "place", ("level", "area"))
    level = None
    if "level" in table.value:
        level = cast(Level, table.choice("level", LEVELS))
    area = None
    if "area" in table.value:
        xmin, ymin, xmax, ymax = table.numbers("area", 4)
        area = (xmin, ymin, xmax, ymax)
    return Place(level, still=True, area=area)


def _parse_output(document: JsonObject, folder: Path) -> OutputConfig:
    """Parse formats and folders of the output, empty without any."""
    table = _take_table(document, "output", _OUTPUT_KEYS)
    if not table.value:
        return OutputConfig()
    names = table.texts("to")
    for name in names:
        if name not in STANDARDS:
            raise ValueError(
                f"output.to has no writer {name!r}: choose among {', '.join(STANDARDS)}"
            )
    origin = None
    if "origin" in table.value:
        latitude, longitude = table.numbers("origin", 2)
        origin = GeoOrigin(latitude, longitude)
    target = folder / table.get("folder", str)
    return OutputConfig(
        {name: target / name for name in names},
        piece_s=_take_number(table, "piece_s", PIECE_S, (0.1, _MAX_S)),
        origin=origin,
        asn1=folder / table.get("asn1", str) if "asn1" in table.value else None,
        clouds=_take(table, "clouds", bool, default=False),
    )


def _take_table(document: JsonObject, key: str, keys: Collection[str]) -> JsonObject:
    """Return a table with known keys, an empty one if it is missing."""
    table = document.node(key) if key in document.value else JsonObject({}, key)
    table.check_keys(keys)
    return table


def _take(row: JsonObject, key: str, kind: type, default: Any) -> Any:
    """Return a member of a kind, or a default if it is missing."""
    return row.get(key, kind) if key in row.value else default


def _take_count(row: JsonObject, key: str, maximum: int) -> int:
    """Return a whole number from 1 to a maximum, 1 if it is missing."""
    return row.whole(key, low=1, high=maximum) if key in row.value else 1


def _take_number(row: JsonObject, key: str, default: Any, limits: tuple[float, float]) -> Any:
    """Return a number within limits, or a default if it is missing."""
    return row.number(key, *limits) if key in row.value else default
