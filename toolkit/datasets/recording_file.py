"""Files of simulated recordings: made of scenes, and joined from shards."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import h5py
import numpy as np

from toolkit.arrays import Int64
from toolkit.datasets import published_layout as published
from toolkit.datasets.stored_channels import OWN_IMAGES
from toolkit.frame import Frame
from toolkit.runtime.hdf5 import hdf5_file
from toolkit.sensors.models import DepthCamera
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import format_site
from toolkit.sites.site import Site

RECORDING_SCHEMA = 1
_GZIP_LEVEL = 1  # the fastest


@dataclass(frozen=True)
class Header:
    """Values shared by all frames of a recording.

    site: the site; sensors: in the order of a frame's measurements; bodies: their names; plan: the
    simulation's plan, see `toolkit.datasets.simulation`."""

    site: Site
    sensors: tuple[Sensor, ...]
    bodies: tuple[str, ...] = ()
    plan: str = "{}"

    @property
    def images(self) -> tuple[str, ...]:
        """Name of the dataset with each sensor's measurements, in the order of `sensors`.

        Cameras share `dslices` if all have one size; any other sensor has a dataset for itself."""
        cameras = self.pinholes
        have_one_size = len({(camera.height, camera.width) for camera in cameras.values()}) == 1
        names = []
        for sensor in self.sensors:
            if have_one_size and sensor.name in cameras:
                names.append("dslices")
            else:
                group = OWN_IMAGES[sensor.model.measures]  # "depth" or "ranges"
                names.append(f"coview/{group}/{sensor.name}")
        return tuple(names)

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
    """One frame to be recorded.

    bodies: for each object of the frame, the index of its body in `Header.bodies`."""

    frame: Frame
    bodies: Int64[np.ndarray, " n"]


def encode(header: Header, scenes: Sequence[Scene]) -> bytes:
    """Return the bytes of a complete HDF5 file of scenes.

    header: what all scenes share. They are made in memory, so that whoever writes them can write
    all or none."""
    object_counts = [len(scene.frame.objects) for scene in scenes]
    # in memory, which grows by 4 MiB at a time
    with h5py.File("memory", "w", driver="core", backing_store=False, block_size=1 << 22) as file:
        _create(file, header, frames=len(scenes), objects=sum(object_counts))
        # the objects of all frames are one after the other
        # rows of the first object of each frame, then the number of all objects
        object_start = np.concatenate([[0], np.cumsum(object_counts, dtype=np.int64)])
        file["coview/object_start"][:] = object_start
        for number, scene in enumerate(scenes):
            frame = scene.frame
            file["coview/time"][number] = frame.time
            rows = published.format_objects(frame.objects, header.site.map_SE3_site)
            _add(file, f"objects/{number}", rows)
            object_range = slice(object_start[number], object_start[number + 1])
            file["coview/object_ids"][object_range] = frame.objects.ids
            file["coview/object_bodies"][object_range] = scene.bodies
            _write_images(file, header, frame, number)
        file.flush()
        return file.id.get_file_image()


def _write_images(file: h5py.File, header: Header, frame: Frame, number: int) -> None:
    """Write the images of a frame into the datasets that `header.images` names.

    number: number of the frame in the file."""
    cameras = header.pinholes
    camera_number = 0
    for sensor, image, name in zip(header.sensors, frame.images, header.images, strict=True):
        if name == "dslices":  # cameras of one size share it
            full_image = published.expand_image(image, cameras[sensor.name])
            file[name][number, camera_number] = full_image
            camera_number += 1
        else:
            file[name][number] = published.round_measurement(image)


def join(header: Header, shards: Sequence[Path], out: Path) -> None:
    """Write the frames of several files made by `encode`, in order, as one file.

    header: header of the new file; shards: the files; out: path of the new file. Compressed images
    are copied without unpacking."""
    frame_counts = []
    object_counts = []
    for path in shards:
        with h5py.File(path) as shard:
            frame_counts.append(len(shard["coview/time"]))
            object_counts.append(len(shard["coview/object_ids"]))
    with hdf5_file(out) as (target, check):
        _create(target, header, frames=sum(frame_counts), objects=sum(object_counts))
        first_frame = 0
        first_object = 0
        for path, frames, objects in zip(shards, frame_counts, object_counts, strict=True):
            with h5py.File(path) as shard:
                target["coview/time"][first_frame : first_frame + frames] = shard["coview/time"][:]
                # one more than frames: the end of a shard is written again as the next one's start
                starts = first_object + shard["coview/object_start"][:]
                target["coview/object_start"][first_frame : first_frame + frames + 1] = starts
                for column in ("coview/object_ids", "coview/object_bodies"):
                    target[column][first_object : first_object + objects] = shard[column][:]
                for number in range(frames):
                    rows = shard[f"objects/{number}"][:]
                    _add(target, f"objects/{first_frame + number}", rows)
                for name in dict.fromkeys(header.images):
                    _copy_chunks(shard[name], target[name], first_frame)
            check()  # raises if the disk failed
            first_frame += frames
            first_object += objects


def _copy_chunks(source: h5py.Dataset, target: h5py.Dataset, first_frame: int) -> None:
    """Copy all compressed images of a dataset as they are, frame 0 to frame `first_frame` and on.

    Both datasets must have the same chunks and filters; axis 0 is the frames."""
    for index in range(source.id.get_num_chunks()):
        chunk_offset = source.id.get_chunk_info(index).chunk_offset
        filter_mask, content = source.id.read_direct_chunk(chunk_offset)
        target_offset = (first_frame + chunk_offset[0], *chunk_offset[1:])  # axis 0 is frames
        target.id.write_direct_chunk(target_offset, content, filter_mask)


def _create(file: h5py.File, header: Header, *, frames: int, objects: int) -> None:
    """Make all groups and datasets of a file; leave frames and objects to be filled in.

    frames, objects: their numbers in the file."""
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
    """Make an empty, compressed float32 dataset of a shape.

    A chunk holds one image, that is, the last two axes."""
    chunks = (*(1,) * (len(shape) - 2), *shape[-2:])
    return file.create_dataset(
        name,
        shape,
        np.float32,
        chunks=chunks,
        compression="gzip",
        compression_opts=_GZIP_LEVEL,
        shuffle=True,
        track_times=False,
    )


def _add(group: h5py.Group, name: str, content: np.ndarray | str) -> None:
    # without times, so that equal recordings have equal bytes
    group.create_dataset(name, data=content, track_times=False)
