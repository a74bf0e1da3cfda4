"""Sensors of an HDF5 file of images, and the place of their measurements."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import NamedTuple

import h5py
import numpy as np

from toolkit.datasets import published_layout as published
from toolkit.runtime import hdf5
from toolkit.runtime.text_values import parse_json
from toolkit.sensors.models import DepthCamera, find_model_class, make_model
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

# group in coview/ of images that are not in `dslices`, by what a sensor measures
OWN_IMAGES = {"depth": "depth", "range": "ranges"}


class StoredChannel(NamedTuple):
    """Sensor, and the place of its measurements.

    sensor: the sensor; name: dataset of its measurements; depth_index: index in `dslices`, None in
    other datasets; stride: step of its measured pixels there."""

    sensor: Sensor
    name: str
    depth_index: int | None = None
    stride: int = 1


def list_channels(file: h5py.File, cameras: Sequence[str], site: Site) -> tuple[StoredChannel, ...]:
    """List the sensors of a file and where their images are, in the order of a frame.

    cameras: names of the groups in cameras/, in the order of the dataset `dslices`; site: its place
    in the map, in which published cameras are placed. Raises ValueError for another layout."""
    stored_channels: list[StoredChannel] = []
    has_shared_images = hdf5.contains(file, "dslices")
    if has_shared_images:
        stored_channels += _list_depth_channels(file, cameras, site)
    for group in OWN_IMAGES.values():
        for name in hdf5.child_names(file, f"coview/{group}"):
            stored_channels.append(_read_own_channel(file, f"coview/{group}/{name}"))
    if not has_shared_images and not stored_channels:
        content = hdf5.child_names(file, "/") or "nothing"
        raise ValueError(
            f"dataset 'dslices' (depth images [T, C, H, W]) is missing: it holds {content}"
        )
    channels = {channel.sensor.name: channel for channel in stored_channels}
    if len(channels) < len(stored_channels):
        names = ", ".join(channel.sensor.name for channel in stored_channels)
        raise ValueError(f"every sensor needs a name of its own, got {names}")
    order = _sensor_order(file)
    if order and sorted(order) != sorted(channels):
        raise ValueError(
            f"attribute coview:sensors names {order}, but measurements are there of "
            f"{sorted(channels)}"
        )
    return tuple(channels[name] for name in order or channels)


def _list_depth_channels(
    file: h5py.File, cameras: Sequence[str], site: Site
) -> list[StoredChannel]:
    """List the cameras whose images are in the dataset `dslices`, in its order.

    cameras: names of their groups in cameras/; site: its place in the map, in which published
    cameras are placed."""
    depth = hdf5.dataset(file, "dslices", kinds="fiub")
    if depth.ndim != 4 or depth.dtype.kind != "f":
        raise ValueError(
            f"dslices must be floats of shape [T, C, H, W], got {depth.dtype} of shape "
            f"{depth.shape}"
        )
    camera_count = depth.shape[1]
    height, width = depth.shape[2:]
    if len(cameras) != camera_count:
        camera_text = f"{len(cameras)} whose name starts with d: {', '.join(cameras) or 'none'}"
        raise ValueError(
            f"dslices has {camera_count} depth images a frame, but cameras/ has {camera_text}"
        )
    channels = []
    for index, name in enumerate(cameras):
        sensor, stride = _read_stored_camera(file[f"cameras/{name}"], (height, width), site)
        channels.append(StoredChannel(sensor, name="dslices", depth_index=index, stride=stride))
    return channels


def _read_own_channel(file: h5py.File, name: str) -> StoredChannel:
    """Return a sensor with a separate dataset of images. name: path of the dataset."""
    images = hdf5.dataset(file, name, axes=3)
    sensor = _parse_sensor(hdf5.read_node_attributes(images, name), name)
    if images.shape[1:] != sensor.model.shape:
        raise ValueError(f"{name} must be [T, *{sensor.model.shape}], got {images.shape}")
    return StoredChannel(sensor, name)


def _sensor_order(file: h5py.File) -> list[str]:
    """Names of the sensors in the order of a frame's measurements, empty if the file lacks them."""
    attributes: Mapping[str, object] = {}
    if hdf5.contains(file, "coview"):
        attributes = hdf5.read_node_attributes(file["coview"], "coview")
    order_text = attributes.get("sensors", "[]")
    try:
        order = parse_json(order_text) if isinstance(order_text, str) else None
    except ValueError:
        order = None
    if not isinstance(order, list) or not all(isinstance(name, str) for name in order):
        raise ValueError(
            f"attribute coview:sensors must be a JSON list of names, got {str(order_text)[:60]!r}"
        )
    return order


def _read_stored_camera(
    group: h5py.Group, shape: tuple[int, int], site: Site
) -> tuple[Sensor, int]:
    """Return the camera of a group in cameras/, and the step between its measured pixels.

    It is the sensor in the group's attributes only if that agrees with the published matrices,
    else a camera made from these. shape: rows and columns of its full image."""
    name = group.name.lstrip("/")
    intrinsic = hdf5.find_array(group, "intrinsic")
    extrinsic = hdf5.find_array(group, "extrinsic")
    if intrinsic is None or extrinsic is None:
        raise ValueError(f"{name}/{'intrinsic' if intrinsic is None else 'extrinsic'} is missing")
    attributes = hdf5.read_node_attributes(group, name)
    stored_sensor = None
    stride = None
    if "site_SE3_sensor" in attributes:
        stored_sensor = _parse_sensor(attributes, name)
        camera = stored_sensor.model
        if not isinstance(camera, DepthCamera):
            raise ValueError(
                f"{name} is a {type(camera).__name__}, which dslices cannot hold: write the file "
                "again"
            )
        stride = camera.stride
        expected_extrinsic = published.extrinsic(stored_sensor.pose, site.map_SE3_site)
        is_same = _is_equal(published.intrinsic(camera), intrinsic)
        is_same = is_same and _is_equal(expected_extrinsic, extrinsic)
        if is_same and (camera.height, camera.width) == shape:
            return stored_sensor, stride
    height, width = shape
    model = published.parse_intrinsic(intrinsic, height, width, name=f"{name}/intrinsic")
    pose = published.parse_extrinsic(extrinsic, site.map_SE3_site, f"{name}/extrinsic")
    if stored_sensor is None or stride is None:
        return Sensor(name.removeprefix("cameras/"), model, pose), model.stride
    return Sensor(stored_sensor.name, replace(model, stride=stride), pose), stride


def _is_equal(expected: np.ndarray, matrix: np.ndarray) -> bool:
    return expected.shape == matrix.shape and np.allclose(expected, matrix)


def _parse_sensor(attributes: Mapping[str, object], node_name: str) -> Sensor:
    """Return the sensor that the attributes of a group or dataset in a file describe.

    attributes: name, model (name of the class), site_SE3_sensor (pose) and the model's fields;
    node_name: path of the group or dataset, for errors."""
    missing_keys = [key for key in ("name", "model", "site_SE3_sensor") if key not in attributes]
    if missing_keys:
        raise ValueError(f"{node_name} has no attribute {missing_keys[0]}: write the file again")
    try:
        class_name = str(attributes["model"])
        field_names = [entry.name for entry in fields(find_model_class(class_name))]
        values = {
            name: np.asarray(attributes[name]).tolist()
            for name in field_names
            if name in attributes
        }
        return Sensor(
            name=str(attributes["name"]),
            model=make_model(class_name, values),
            pose=np.asarray(attributes["site_SE3_sensor"]),
        )
    except (TypeError, AttributeError, ValueError, OverflowError) as error:
        problem = f"attributes of {node_name} describe no sensor ({error})"
        raise ValueError(f"{problem}: the file is damaged, restore it") from None
