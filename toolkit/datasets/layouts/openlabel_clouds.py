"""Clouds of OpenLABEL's frames, and their sensors.

A frame's clouds are point_cloud_file_names (TUM Traffic), the `uri` of its streams, or files
named as the labels. A cloud's sensor is the stream with its uri, else the one in the name of its
folder or file."""

from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath, PureWindowsPath

from toolkit.datasets import folders
from toolkit.datasets.problem_kinds import Problems, add_problem
from toolkit.datasets.record_values import Unchecked

NO_CLOUD = "clouds that a frame names and that are not there"
ONLY_SENSOR = "clouds whose sensor nothing tells, taken as the file's only one"
STREAM_BY_ORDER = "clouds whose stream only its place in the list tells"
_OTHER_STREAMS = ("camera", "radar", "gps_imu", "other")
CloudFiles = Mapping[str, Sequence[Path]]  # cloud files below a folder by name


def _streams(content: Unchecked, frame: Unchecked) -> dict[str, Unchecked]:
    """Streams that may be lidars, as the file and the frame describe them together."""
    of_frame = (frame.get("frame_properties") or {}).get("streams") or {}
    of_file = content.get("streams") or {}
    together = {}
    for name in [*of_frame, *(name for name in of_file if name not in of_frame)]:
        together[name] = {**(of_file.get(name) or {}), **(of_frame.get(name) or {})}
    return {
        name: stream
        for name, stream in together.items()
        if stream.get("type") not in _OTHER_STREAMS
    }


def find_sensors(
    file: Path, content: Unchecked, frame: Unchecked, clouds: CloudFiles, problems: Problems
) -> dict[str, Path]:
    """Cloud file of each sensor of a frame."""
    of_streams = _find_stream_clouds(file, content, frame, clouds)
    files = _find_clouds(file, frame, of_streams, clouds, problems)
    return _name_sensors(content, frame, files, of_streams, problems)


def _find_clouds(
    file: Path,
    frame: Unchecked,
    of_streams: Mapping[Path, str],
    clouds: CloudFiles,
    problems: Problems,
) -> list[Path]:
    """Files of a frame's clouds: as the frame names them, by its streams, else by its file's
    name."""
    listed = [
        str(name)
        for name in (frame.get("frame_properties") or {}).get("point_cloud_file_names") or ()
    ]
    if listed:
        matches = [_find_cloud(name, file, clouds) for name in listed]
        present = list(dict.fromkeys(cloud for cloud in matches if cloud is not None))
        add_problem(problems, NO_CLOUD, matches.count(None) if present else 0)
        return present
    if of_streams:
        return list(of_streams)
    candidates = [
        cloud for ending in folders.ENDINGS for cloud in clouds.get(f"{file.stem}{ending}", ())
    ]
    of_folder = [cloud for cloud in candidates if cloud.parent.name == file.parent.name]
    return of_folder[:1] or candidates


def _find_stream_clouds(
    file: Path, content: Unchecked, frame: Unchecked, clouds: CloudFiles
) -> dict[Path, str]:
    """Streams by the cloud files that their uri names."""
    streams: dict[Path, str] = {}
    for name, stream in _streams(content, frame).items():
        cloud = _find_cloud(str(stream.get("uri") or ""), file, clouds)
        if cloud is not None:
            streams.setdefault(cloud, name)
    return streams


def _find_cloud(location: str, labels: Path, clouds: CloudFiles) -> Path | None:
    """File that a label file names; among files of one name, the one with most folders in
    common."""
    candidates = clouds.get(PurePosixPath(location).name) or clouds.get(
        PureWindowsPath(location).name, ()
    )
    return max(candidates, key=lambda cloud: _common_tail(cloud, location, labels), default=None)


def _common_tail(cloud: Path, location: str, labels: Path) -> tuple[int, bool]:
    """Fit of a file to the location in a label file: path components in common, and the folder's
    name."""
    pairs = zip(reversed(cloud.parts), reversed(PureWindowsPath(location).parts), strict=False)
    common = 0
    for name, stated_name in pairs:
        if name != stated_name:
            break
        common += 1
    return common, cloud.parent.name == labels.parent.name


def _name_sensors(
    content: Unchecked,
    frame: Unchecked,
    files: Sequence[Path],
    of_streams: Mapping[Path, str],
    problems: Problems,
) -> dict[str, Path]:
    """Cloud of each sensor, named by a stream or coordinate system.

    The stream is the one with this file, or the one in the name of the file or its folder."""
    streams = _streams(content, frame)
    systems = content.get("coordinate_systems") or {}
    sensors: dict[str, Path] = {}
    for index, file in enumerate(files):
        names_in_stem = [name for name in (*streams, *systems) if name in file.stem]
        if file in of_streams:
            name = of_streams[file]
        elif file.parent.name in streams or file.parent.name in systems:
            name = file.parent.name
        elif names_in_stem:
            name = max(names_in_stem, key=len)
        elif index < len(streams):
            name = list(streams)[index]
            add_problem(problems, STREAM_BY_ORDER, 1)
        elif len(files) == 1 and len(single := _list_sensors(systems)) == 1:
            (name,) = single
            add_problem(problems, ONLY_SENSOR, 1)
        else:
            name = file.parent.name
        sensors[name if name not in sensors else file.stem] = file
    return sensors


def _list_sensors(systems: Mapping[str, Unchecked]) -> list[str]:
    """Names of the coordinate systems that are sensors by their type, else that are nobody's
    parent."""
    of_type = [
        name for name, system in systems.items() if "sensor" in str(system.get("type")).lower()
    ]
    parents = {system.get("parent") for system in systems.values()}
    return of_type or [
        name for name, system in systems.items() if system.get("parent") and name not in parents
    ]
