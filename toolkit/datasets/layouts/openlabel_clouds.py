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


def _list_streams(content: Unchecked, frame: Unchecked) -> dict[str, Unchecked]:
    """Return the entries of streams (sensors) by name, if they may be lidars.

    Entries of the frame replace the file's. Streams of the frame come first. content, frame:
    entries of the file and of one frame."""
    frame_streams = (frame.get("frame_properties") or {}).get("streams") or {}
    file_streams = content.get("streams") or {}
    streams = {}
    for name in dict.fromkeys([*frame_streams, *file_streams]):
        stream = {**(file_streams.get(name) or {}), **(frame_streams.get(name) or {})}
        if stream.get("type") not in _OTHER_STREAMS:
            streams[name] = stream
    return streams


def find_sensors(
    file: Path, content: Unchecked, frame: Unchecked, clouds: CloudFiles, problems: Problems
) -> dict[str, Path]:
    """Find the cloud file of each sensor of a frame, by the sensor's name.

    file: the label file; content: its content; clouds: files below the folder by name; problems:
    counts of clouds that are missing or placed by a guess are added to it."""
    stream_of_cloud = _find_stream_clouds(file, content, frame, clouds)
    files = _find_clouds(file, frame, stream_of_cloud, clouds, problems)
    return _name_sensors(content, frame, files, stream_of_cloud, problems)


def _find_clouds(
    file: Path,
    frame: Unchecked,
    stream_of_cloud: Mapping[Path, str],
    clouds: CloudFiles,
    problems: Problems,
) -> list[Path]:
    """Find the files of a frame's clouds: as it names them, by streams, else by its file's name.

    file: the label file; stream_of_cloud: stream of each cloud file that a uri names; clouds: files
    below the folder by name; problems: the number of missing clouds is added to it, unless all are
    missing."""
    properties = frame.get("frame_properties") or {}
    stated_names = [str(name) for name in properties.get("point_cloud_file_names") or ()]
    if stated_names:
        matches = [_find_cloud(name, file, clouds) for name in stated_names]
        files = list(dict.fromkeys(cloud for cloud in matches if cloud is not None))
        add_problem(problems, NO_CLOUD, matches.count(None) if files else 0)
        return files
    if stream_of_cloud:
        return list(stream_of_cloud)
    candidates = [
        cloud for ending in folders.ENDINGS for cloud in clouds.get(f"{file.stem}{ending}", ())
    ]
    in_like_folder = [cloud for cloud in candidates if cloud.parent.name == file.parent.name]
    return in_like_folder[:1] or candidates


def _find_stream_clouds(
    file: Path, content: Unchecked, frame: Unchecked, clouds: CloudFiles
) -> dict[Path, str]:
    """Return the name of the stream of each cloud file that a stream's uri names."""
    stream_of_cloud: dict[Path, str] = {}
    for name, stream in _list_streams(content, frame).items():
        cloud = _find_cloud(str(stream.get("uri") or ""), file, clouds)
        if cloud is not None:
            stream_of_cloud.setdefault(cloud, name)
    return stream_of_cloud


def _find_cloud(location: str, labels: Path, clouds: CloudFiles) -> Path | None:
    """Find the cloud file that a label file names, None if it is not there.

    Among files of one name, it is the one with most folders in common. location: path or URL in
    the label file, whose last part must be the file's name; labels: the label file."""
    candidates = clouds.get(PurePosixPath(location).name) or clouds.get(
        PureWindowsPath(location).name, ()
    )
    return max(candidates, key=lambda cloud: _rate_fit(cloud, location, labels), default=None)


def _rate_fit(cloud: Path, location: str, labels: Path) -> tuple[int, bool]:
    """Fit of a cloud file to its location in a label file, as a sort key, larger for a better fit.

    The first value is the number of equal parts at the paths' ends, the second True if cloud and
    labels are in folders of one name. cloud: a cloud file; location: path or URL in the label file;
    labels: the label file."""
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
    stream_of_cloud: Mapping[Path, str],
    problems: Problems,
) -> dict[str, Path]:
    """Return the cloud file of each sensor, with sensors named by a stream or coordinate system.

    The stream is the one with this file, or the one in the name of the file or its folder. files:
    the frame's cloud files; stream_of_cloud: stream of each file that a uri names; problems: counts
    of guesses are added to it."""
    streams = _list_streams(content, frame)
    systems = content.get("coordinate_systems") or {}
    sensors: dict[str, Path] = {}
    for index, file in enumerate(files):
        names_in_stem = [name for name in (*streams, *systems) if name in file.stem]
        if file in stream_of_cloud:
            name = stream_of_cloud[file]
        elif file.parent.name in streams or file.parent.name in systems:
            name = file.parent.name
        elif names_in_stem:
            name = max(names_in_stem, key=len)
        elif index < len(streams):
            name = list(streams)[index]
            add_problem(problems, STREAM_BY_ORDER, 1)
        elif len(files) == 1 and len(sensor_names := _list_sensors(systems)) == 1:
            name = sensor_names[0]
            add_problem(problems, ONLY_SENSOR, 1)
        else:
            name = file.parent.name
        sensors[name if name not in sensors else file.stem] = file
    return sensors


def _list_sensors(systems: Mapping[str, Unchecked]) -> list[str]:
    """Return the names of the coordinate systems that are sensors.

    These are the systems with "sensor" in their type, or, without such a system, those with a
    parent and no child."""
    sensors = [
        name for name, system in systems.items() if "sensor" in str(system.get("type")).lower()
    ]
    if sensors:
        return sensors
    parents = {system.get("parent") for system in systems.values()}
    return [
        name for name, system in systems.items() if system.get("parent") and name not in parents
    ]
