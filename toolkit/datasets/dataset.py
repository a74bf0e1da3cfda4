"""A recording of images as one HDF5 file: the published layout, with our fields in `coview`.

`CoopDataset` reads files of `coview simulate` and the published ones alike; `encode` and `join`
write them.

dslices                float32 [T, C, H, W]  depth along the axis (m), 1000 where nothing returned;
                                             only every stride-th pixel is measured, the others
                                             hold 0
slices                 uint8 [T, 0, H, W, 3] no colour images; the published viewer asks for their
                                             number
cameras/{d00..}        intrinsic, extrinsic  in the published convention; attributes name, stride,
                                             sigma, ...
objects/{k}            float64 [n, 10]       see `toolkit.datasets.published_layout`
coview                 attributes            schema, version, plan, sensors (names, in the order of
                                             a Frame's measurements)
coview/site            text                  the site as GeoJSON
coview/bodies          JSON list             names of the bodies
coview/time            float64 [T]           seconds
coview/object_start    int64 [T + 1]         frame k has objects object_start[k]:object_start[k + 1]
                                             of the next two
coview/object_ids, coview/object_bodies      int64 [N]
coview/ranges/{name}   float32 [T, rows, columns]  a lidar's ranges (m), 0 where nothing returned;
                                             attributes as for cameras: name, model (its class),
                                             fields of the model
coview/depth/{name}    float32 [T, rows, columns]  depths that cannot share `dslices`: cameras that
                                             differ in size"""

import json
import operator
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import NamedTuple, SupportsIndex, overload

import h5py
import numpy as np

from toolkit.arrays import Int64
from toolkit.datasets import published_layout as published
from toolkit.frame import DisplayedRecording, Frame, Rectangle
from toolkit.objects import LABELS, Objects
from toolkit.runtime import hdf5
from toolkit.runtime.files import parse_json
from toolkit.runtime.hdf5 import hdf5_file
from toolkit.sensors.models import DepthCamera, find_model_class, make_model
from toolkit.sensors.sensor import Sensor
from toolkit.sites import BUILT_IN
from toolkit.sites.files import format_site, load_site, parse
from toolkit.sites.site import Site

CLOUDS_KIND = "clouds"  # the attribute `coview` of a file of recorded clouds
_GROUPS = ("objects", "cameras", "coview", "coview/ranges", "coview/depth")
RECORDING_SCHEMA = 1
_GZIP_LEVEL = 1
OWN_IMAGES = {"depth": "depth", "range": "ranges"}  # group of coview/ by a sensor's measurement


class UnknownSite(ValueError):
    """A recording that does not name its site, and shows none that is known."""


class StoredChannel(NamedTuple):
    """Sensor, and the place of its measurements.

    sensor: the sensor; name: dataset of its measurements; depth_index: index in `dslices`, None in
    other datasets; stride: step of its measured pixels there."""

    sensor: Sensor
    name: str
    depth_index: int | None = None
    stride: int = 1


class CoopDataset(DisplayedRecording, Sequence[Frame]):
    """Noise-free frames of an HDF5 file, in the site frame.

    `dataset[k]` is a `Frame`; a slice is a list of frames. The file is opened when needed, and
    again in every process it is sent to. Usable in a `with` statement.

    path: a file of `coview simulate` or one in the published layout. site: the site that it shows;
    our files name it, published ones are recognised if they show a built-in site. drop_invalid:
    leave out rows that no object can have (NaN, no size, kilometres away, see
    `published_layout.wrong_rows`), with one warning that counts them. Otherwise reading a frame
    with such a row raises ValueError.

    Raises FileNotFoundError; OSError for a file that is cut off or not HDF5; ValueError, which
    names the fault in the file, for another layout; IndexError for an unknown frame."""

    def __init__(
        self, path: str | Path, site: Site | None = None, *, drop_invalid: bool = False
    ) -> None:
        self.path = Path(path)
        self.drop_invalid = drop_invalid
        self._open: tuple[int, h5py.File, dict[str, h5py.Dataset]] | None = None
        file, _ = self._file()
        try:
            cameras = check_kinds(file)
            self.site = site if site is not None else _site(file, cameras)
            self.channels = _channels(file, cameras, self.site)
            self.sensors = tuple(channel.sensor for channel in self.channels)
            xmin, ymin, xmax, ymax = self.site.area.tolist()
            self._area = Rectangle((xmin, ymin, xmax, ymax))
            self.times = hdf5.find_array(file, "coview/time", axes=1)
            self._starts = hdf5.find_array(file, "coview/object_start", axes=1)
            lengths = {
                channel.name: self.stored(channel.name).shape[0] for channel in self.channels
            }
            lengths |= {} if self.times is None else {"coview/time": len(self.times)}
            if len(set(lengths.values())) != 1:
                raise ValueError(
                    f"its datasets must have one length, the number of frames, got {lengths}"
                )
            self._length = next(iter(lengths.values()))
            starts = self._starts
            count = self._length + 1
            is_valid = starts is None or (starts.dtype.kind in "iu" and len(starts) == count)
            if starts is not None and (
                not is_valid or (np.diff(starts.astype(np.int64)) < 0).any()
            ):
                got = f"{len(starts)} of {starts.dtype}"
                raise ValueError(
                    f"coview/object_start must be {count} whole numbers that ascend, got {got}"
                )
            if drop_invalid:
                self._warn_of_invalid(file)
        except (ValueError, OSError) as error:
            self.close()
            raise type(error)(f"{path}: {error}") from None

    def __len__(self) -> int:
        return self._length

    @overload
    def __getitem__(self, index: SupportsIndex) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> list[Frame]: ...
    def __getitem__(self, index: SupportsIndex | slice) -> Frame | list[Frame]:
        if isinstance(index, slice):
            return [self._frame(k) for k in range(*index.indices(len(self)))]
        k = operator.index(index)
        if not -len(self) <= k < len(self):
            raise IndexError(
                f"frame {k} is out of range: {self.path} has {len(self)} frames, 0 to "
                f"{len(self) - 1}"
            )
        return self._frame(k % len(self))

    def __iter__(self) -> Iterator[Frame]:
        return (self._frame(k) for k in range(len(self)))

    def close(self) -> None:
        """Close the file; the next access opens it again."""
        if self._open is not None and self._open[0] == os.getpid():
            self._open[1].close()
        self._open = None

    def stored(self, name: str, *, axes: int | None = None, kinds: str = "fiu") -> h5py.Dataset:
        """Dataset of the file, such as a channel's, checked on first use."""
        file, checked = self._file()
        if name not in checked:
            checked[name] = hdf5.dataset(file, name, axes=axes, kinds=kinds)
        return checked[name]

    def __enter__(self) -> "CoopDataset":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __getstate__(self) -> dict[str, object]:
        return {**self.__dict__, "_open": None}

    def _file(self) -> tuple[h5py.File, dict[str, h5py.Dataset]]:
        # a forked process must not share the parent's handle
        if self._open is None or self._open[0] != os.getpid():
            self._open = os.getpid(), open_file(self.path), {}
        return self._open[1:]

    def _frame(self, k: int) -> Frame:
        file, _ = self._file()
        try:
            names = dict.fromkeys(channel.name for channel in self.channels)
            images = {name: hdf5.rows(self.stored(name), name, k) for name in names}
            shared = [
                (images[c.name][c.depth_index], c.stride)
                for c in self.channels
                if c.depth_index is not None
            ]
            measured = iter(published.measured(shared))
            measurements = tuple(
                images[stored.name].astype(np.float32)
                if stored.depth_index is None
                else next(measured)
                for stored in self.channels
            )
            objects = self._objects(file, k)
        except OSError as error:
            raise OSError(f"{self.path}: frame {k} cannot be read: {error}") from None
        except ValueError as error:
            raise type(error)(f"{self.path}: frame {k}: {error}") from None
        time = 0.0 if self.times is None else float(self.times[k])
        frame = partial(Frame, complete=self._area, map_SE3_world=self.site.map_SE3_site)
        categories = tuple(LABELS[label] for label in objects.labels.tolist())
        return frame(
            self.sensors, measurements, objects, time, k, name=f"{k:06d}", categories=categories
        )

    def _objects(self, file: h5py.File, k: int) -> Objects:
        name = f"objects/{k}"
        ids = None
        rows = object_rows(file, name)
        if self._starts is not None:
            stored = self.stored("coview/object_ids", axes=1, kinds="iu")
            ids = hdf5.rows(stored, "coview/object_ids", slice(*self._starts[k : k + 2].tolist()))
            if len(ids) != len(rows):
                raise ValueError(
                    f"{name} has {len(rows)} rows, but there are {len(ids)} coview/object_ids for "
                    "it"
                )
        if self.drop_invalid:
            sound = published.wrong_rows(rows) == ""
            rows = rows[sound]
            ids = None if ids is None else ids[sound]
        return published.parse_rows(rows, self.site.map_SE3_site, ids, name)

    def _warn_of_invalid(self, file: h5py.File) -> None:
        """Warn how many objects are left out, and describe the first one's fault."""
        faults = {
            k: published.wrong_rows(object_rows(file, f"objects/{k}")) for k in range(self._length)
        }
        frames = [k for k, words in faults.items() if (words != "").any()]
        if frames:
            count = sum(int((words != "").sum()) for words in faults.values())
            first = faults[frames[0]]
            row = int((first != "").argmax())
            example = f"objects/{frames[0]} row {row}, which {first[row]}"
            left_out = f"{self.path}: {count} objects in {len(frames)} frames are left out"
            warnings.warn(f"{left_out}, the first is {example}", stacklevel=4)


def open_file(path: str | Path) -> h5py.File:
    """Open an HDF5 file for reading.

    Raises FileNotFoundError or OSError, which state in one line what is wrong."""
    path = Path(path)
    if not path.exists():
        unfinished = path.with_name(path.name + ".parts").is_dir()
        hint = (
            "its simulation is not finished, start it again to go on"
            if unfinished
            else "check the path"
        )
        raise FileNotFoundError(f"no dataset {path}: {hint}")
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder: give the HDF5 file itself")
    return hdf5.open_hdf5(path)


def object_rows(file: h5py.File, name: str) -> np.ndarray:
    """Published object rows of a frame, unchecked. Raises ValueError if they cannot be read."""
    rows = hdf5.find_array(file, name, kinds="fiub")
    if rows is None:
        raise ValueError(f"{name} is missing: every frame needs its objects, no rows for none")
    if not rows.ndim:
        raise ValueError(
            f"{name} must have {len(published.OBJECT_COLUMNS)} columns, got a single number"
        )
    return rows if rows.size else np.zeros((0, len(published.OBJECT_COLUMNS)))


def check_kinds(file: h5py.File) -> tuple[str, ...]:
    """Check that groups and datasets are as the layout expects, and return `list_cameras`.

    Raises ValueError for a dataset in place of a group, for a group in place of a dataset, and for
    a file of recorded clouds."""
    if str(hdf5.read_node_attributes(file, "the file").get("coview", "")) == CLOUDS_KIND:
        raise ValueError("it holds recorded clouds, not images: give --layout hdf5")
    cameras = list_cameras(file)
    for name, kind in hdf5.find_kinds(
        file, ("dslices", *_GROUPS, *(f"cameras/{name}" for name in cameras))
    ).items():
        expected = h5py.Dataset if name == "dslices" else h5py.Group
        if not issubclass(kind, expected):
            words = f"{expected.__name__.lower()}, got a {kind.__name__.lower()}"
            raise ValueError(f"{name} must be an HDF5 {words}: see toolkit.datasets.dataset")
    return cameras


def list_cameras(file: h5py.File) -> tuple[str, ...]:
    """Names of the depth cameras in the order of `dslices`.

    They start with d and are in alphabetical order."""
    return tuple(sorted(name for name in hdf5.child_names(file, "cameras") if name.startswith("d")))


def _site(file: h5py.File, cameras: Sequence[str]) -> Site:
    """Site of a file: the stored one, else the built-in one around most cameras or objects."""
    if hdf5.contains(file, "coview/site"):
        try:
            return parse(parse_json(hdf5.text(file, "coview/site")))
        except (ValueError, OSError) as error:
            raise UnknownSite(
                f"coview/site is damaged ({error}): pass site= to read the file all the same"
            ) from None
    matrices = [hdf5.array(file, f"cameras/{name}/extrinsic") for name in cameras]
    usable = [matrix for matrix in matrices if matrix.shape == (4, 4) and np.isfinite(matrix).all()]
    positions = [np.linalg.pinv(matrix)[None, :2, 3] for matrix in usable]
    tables = (
        hdf5.array(file, f"objects/{k}", kinds="fiub")
        for k in islice(hdf5.child_names(file, "objects"), 20)
    )
    centres = [objects[:, :2] for objects in tables if objects.ndim == 2 and objects.shape[1] > 1]
    for site in map(load_site, BUILT_IN):
        carla_to_site = np.linalg.inv(published.MAP_FROM_CARLA @ site.map_SE3_site)
        for places in (positions, centres):
            xy = (
                np.concatenate([np.zeros((0, 2)), *places]) @ carla_to_site[:2, :2].T
                + carla_to_site[:2, 3]
            )
            is_inside = ((xy > site.area[:2] - 15) & (xy < site.area[2:] + 15)).all(axis=1)
            if len(xy) and is_inside.mean() > 0.5:
                return site
    raise UnknownSite(
        f"it does not say which site it shows and is none of {', '.join(BUILT_IN)}: pass site="
    )


def _channels(file: h5py.File, cameras: Sequence[str], site: Site) -> tuple[StoredChannel, ...]:
    """Sensors of a file and their measurements, in the order of a frame's measurements."""
    stored: list[StoredChannel] = []
    has_images = hdf5.contains(file, "dslices")
    if has_images:
        stored += _depth_channels(file, cameras, site)
    own_images = list[str]()
    for kind in OWN_IMAGES.values():
        own_images += [f"coview/{kind}/{name}" for name in hdf5.child_names(file, f"coview/{kind}")]
    stored += [_own_channel(file, name) for name in own_images]
    if not has_images and not stored:
        content = hdf5.child_names(file, "/") or "nothing"
        raise ValueError(
            f"dataset 'dslices' (depth images [T, C, H, W]) is missing: it holds {content}"
        )
    channels = {channel.sensor.name: channel for channel in stored}
    if len(channels) < len(stored):
        names = ", ".join(channel.sensor.name for channel in stored)
        raise ValueError(f"every sensor needs a name of its own, got {names}")
    order = _sensor_order(file)
    if order and sorted(order) != sorted(channels):
        raise ValueError(
            f"attribute coview:sensors names {order}, but measurements are there of "
            f"{sorted(channels)}"
        )
    return tuple(channels[name] for name in order or channels)


def _depth_channels(file: h5py.File, cameras: Sequence[str], site: Site) -> list[StoredChannel]:
    """Cameras whose images are in `dslices`."""
    depth = hdf5.dataset(file, "dslices", kinds="fiub")
    if depth.ndim != 4 or depth.dtype.kind != "f":
        raise ValueError(
            f"dslices must be floats of shape [T, C, H, W], got {depth.dtype} of shape "
            f"{depth.shape}"
        )
    if len(cameras) != depth.shape[1]:
        camera_text = f"{len(cameras)} whose name starts with d: {', '.join(cameras) or 'none'}"
        raise ValueError(
            f"dslices has {depth.shape[1]} depth images a frame, but cameras/ has {camera_text}"
        )
    stored = []
    for index, name in enumerate(cameras):
        sensor, stride = _camera(file[f"cameras/{name}"], depth.shape[2:], site)
        stored.append(StoredChannel(sensor, "dslices", index, stride))
    return stored


def _own_channel(file: h5py.File, name: str) -> StoredChannel:
    """Sensor with a separate dataset of images."""
    images = hdf5.dataset(file, name, axes=3)
    sensor = _own_sensor(hdf5.read_node_attributes(images, name), name)
    if images.shape[1:] != sensor.model.shape:
        raise ValueError(f"{name} must be [T, *{sensor.model.shape}], got {images.shape}")
    return StoredChannel(sensor, name)


def _sensor_order(file: h5py.File) -> list[str]:
    """Names of the sensors in the order of a frame's measurements, empty if the file lacks them."""
    attributes: Mapping[str, object] = {}
    if hdf5.contains(file, "coview"):
        attributes = hdf5.read_node_attributes(file["coview"], "coview")
    written = attributes.get("sensors", "[]")
    try:
        order = parse_json(written) if isinstance(written, str) else None
    except ValueError:
        order = None
    if not isinstance(order, list) or not all(isinstance(name, str) for name in order):
        raise ValueError(
            f"attribute coview:sensors must be a JSON list of names, got {str(written)[:60]!r}"
        )
    return order


def _camera(group: h5py.Group, shape: tuple[int, int], site: Site) -> tuple[Sensor, int]:
    """Camera of a group, and its stride.

    It is the stored sensor only if the published matrices agree."""
    name = group.name.lstrip("/")
    intrinsic = hdf5.find_array(group, "intrinsic")
    extrinsic = hdf5.find_array(group, "extrinsic")
    if intrinsic is None or extrinsic is None:
        raise ValueError(f"{name}/{'intrinsic' if intrinsic is None else 'extrinsic'} is missing")
    attributes = hdf5.read_node_attributes(group, name)
    stored_sensor = None
    stride = None
    if "site_SE3_sensor" in attributes:
        stored_sensor = _own_sensor(attributes, name)
        camera = stored_sensor.model
        if not isinstance(camera, DepthCamera):
            raise ValueError(
                f"{name} is a {type(camera).__name__}, which dslices cannot hold: write the file "
                "again"
            )
        stride = camera.stride
        expected = published.extrinsic(stored_sensor.pose, site.map_SE3_site)
        is_same = _is_equal(published.intrinsic(camera), intrinsic)
        is_same = is_same and _is_equal(expected, extrinsic)
        if is_same and (camera.height, camera.width) == shape:
            return stored_sensor, stride
    model = published.parse_intrinsic(intrinsic, *shape, name=f"{name}/intrinsic")
    pose = published.parse_extrinsic(extrinsic, site.map_SE3_site, f"{name}/extrinsic")
    if stored_sensor is None or stride is None:
        return Sensor(name.removeprefix("cameras/"), model, pose), model.stride
    return Sensor(stored_sensor.name, replace(model, stride=stride), pose), stride


def _is_equal(expected: np.ndarray, matrix: np.ndarray) -> bool:
    return expected.shape == matrix.shape and np.allclose(expected, matrix)


def _own_sensor(attributes: Mapping[str, object], node_name: str) -> Sensor:
    missing = [key for key in ("name", "model", "site_SE3_sensor") if key not in attributes]
    if missing:
        raise ValueError(f"{node_name} has no attribute {missing[0]}: write the file again")
    try:
        kind = str(attributes["model"])
        entries = [
            entry.name for entry in fields(find_model_class(kind)) if entry.name in attributes
        ]
        values = {name: np.asarray(attributes[name]).tolist() for name in entries}
        return Sensor(
            str(attributes["name"]),
            make_model(kind, values),
            np.asarray(attributes["site_SE3_sensor"]),
        )
    except (TypeError, AttributeError, ValueError, OverflowError) as error:
        wrong = f"attributes of {node_name} describe no sensor ({error})"
        raise ValueError(f"{wrong}: the file is damaged, restore it") from None


@dataclass(frozen=True)
class Header:
    """Values shared by all frames of a recording.

    site: the site; sensors: in the order of a frame's measurements; bodies: their names; plan: plan
    of the simulation, see `toolkit.datasets.simulation`."""

    site: Site
    sensors: tuple[Sensor, ...]
    bodies: tuple[str, ...] = ()
    plan: str = "{}"

    @property
    def images(self) -> tuple[str, ...]:
        """Dataset of each sensor's measurements. The cameras of one common size share `dslices`."""
        pinholes = self.pinholes
        shared = len({(camera.height, camera.width) for camera in pinholes.values()}) == 1
        return tuple(
            "dslices"
            if shared and s.name in pinholes
            else f"coview/{OWN_IMAGES[s.model.measures]}/{s.name}"
            for s in self.sensors
        )

    @property
    def pinholes(self) -> dict[str, DepthCamera]:
        """Cameras that the published layout can hold, by sensor name."""
        return {
            sensor.name: sensor.model
            for sensor in self.sensors
            if isinstance(sensor.model, DepthCamera)
        }


@dataclass(frozen=True)
class Scene:
    """One frame to be recorded. bodies: (n,) body of each object, an index into `Header.bodies`."""

    frame: Frame
    bodies: Int64[np.ndarray, " n"]


def encode(header: Header, scenes: Sequence[Scene]) -> bytes:
    """Bytes of a complete file of `scenes`, made in memory, so that all or no bytes are written."""
    objects = [len(scene.frame.objects) for scene in scenes]
    images = header.images
    pinholes = header.pinholes
    with h5py.File("memory", "w", driver="core", backing_store=False, block_size=1 << 22) as file:
        _create(file, header, len(scenes), sum(objects))
        start = np.concatenate([[0], np.cumsum(objects, dtype=np.int64)])
        file["coview/object_start"][:] = start
        for k, scene in enumerate(scenes):
            frame = scene.frame
            file["coview/time"][k] = frame.time
            _add(
                file,
                f"objects/{k}",
                published.format_objects(frame.objects, header.site.map_SE3_site),
            )
            file["coview/object_ids"][start[k] : start[k + 1]] = frame.objects.ids
            file["coview/object_bodies"][start[k] : start[k + 1]] = scene.bodies
            channel = 0
            for sensor, measurement, name in zip(header.sensors, frame.images, images, strict=True):
                if name == "dslices":
                    file[name][k, channel] = published.expand_image(
                        measurement, pinholes[sensor.name]
                    )
                    channel += 1
                else:
                    file[name][k] = published.rounded(measurement)
        file.flush()
        return file.id.get_file_image()


def join(header: Header, shards: Sequence[Path], out: Path) -> None:
    """Write the frames of all shards, in order, as one file. Compressed images are copied as they
    are."""
    lengths = []
    objects = []
    for shard in shards:
        with h5py.File(shard) as file:
            lengths.append(len(file["coview/time"]))
            objects.append(len(file["coview/object_ids"]))
    with hdf5_file(out) as (joined, check):
        _create(joined, header, sum(lengths), sum(objects))
        first_frame = 0
        first_object = 0
        for path, frames, count in zip(shards, lengths, objects, strict=True):
            with h5py.File(path) as shard:
                joined["coview/time"][first_frame : first_frame + frames] = shard["coview/time"][:]
                starts = first_object + shard["coview/object_start"][:]
                joined["coview/object_start"][first_frame : first_frame + frames + 1] = starts
                for column in ("coview/object_ids", "coview/object_bodies"):
                    joined[column][first_object : first_object + count] = shard[column][:]
                for k in range(frames):
                    _add(joined, f"objects/{first_frame + k}", shard[f"objects/{k}"][:])
                for name in dict.fromkeys(header.images):
                    source = shard[name].id
                    target = joined[name].id
                    for i in range(source.get_num_chunks()):
                        chunk_offset = source.get_chunk_info(i).chunk_offset
                        mask, compressed = source.read_direct_chunk(chunk_offset)
                        target.write_direct_chunk(
                            (first_frame + chunk_offset[0], *chunk_offset[1:]), compressed, mask
                        )
            check()
            first_frame += frames
            first_object += count


def _create(file: h5py.File, header: Header, frames: int, objects: int) -> None:
    coview_group = file.create_group("coview")
    coview_group.attrs.update(
        schema=RECORDING_SCHEMA,
        plan=header.plan,
        sensors=json.dumps([s.name for s in header.sensors]),
    )
    _add(coview_group, "site", format_site(header.site))
    _add(coview_group, "bodies", json.dumps(header.bodies))
    lengths = {
        "time": frames,
        "object_start": frames + 1,
        "object_ids": objects,
        "object_bodies": objects,
    }
    for name, length in lengths.items():
        coview_group.create_dataset(
            name, (length,), np.float64 if name == "time" else np.int64, track_times=False
        )
    coview_group["time"].attrs["unit"] = "s"
    file.create_group("objects").attrs["columns"] = json.dumps(published.OBJECT_COLUMNS)
    file.create_group("cameras")
    digits = max(2, len(str(len(header.sensors))))
    channel = 0
    for sensor, name in zip(header.sensors, header.images, strict=True):
        if name == "dslices":
            node = file.create_group(f"cameras/d{channel:0{digits}d}")
            camera = header.pinholes[sensor.name]
            _add(node, "intrinsic", published.intrinsic(camera))
            _add(node, "extrinsic", published.extrinsic(sensor.pose, header.site.map_SE3_site))
            channel += 1
        else:
            node = _create_images(file, name, (frames, *sensor.model.shape))
        # numbers that restore the sensor to the last bit: `toolkit.datasets.dataset` reads them
        numbers = {key: value for key, value in asdict(sensor.model).items() if value is not None}
        node.attrs.update(
            name=sensor.name, model=type(sensor.model).__name__, site_SE3_sensor=sensor.pose
        )
        node.attrs.update(numbers)
    if channel:
        images = _create_images(file, "dslices", (frames, channel, camera.height, camera.width))
        images.attrs.update(unit="m", no_return=published.NO_RETURN_M)
        file.create_dataset(
            "slices", (frames, 0, camera.height, camera.width, 3), np.uint8, track_times=False
        )


def _create_images(file: h5py.File, name: str, shape: tuple[int, ...]) -> h5py.Dataset:
    chunks = (*(1,) * (len(shape) - 2), *shape[-2:])
    packed = {
        "compression": "gzip",
        "compression_opts": _GZIP_LEVEL,
        "shuffle": True,
        "track_times": False,
    }
    return file.create_dataset(name, shape, np.float32, chunks=chunks, **packed)


def _add(group: h5py.Group, name: str, content: np.ndarray | str) -> None:
    group.create_dataset(name, data=content, track_times=False)
