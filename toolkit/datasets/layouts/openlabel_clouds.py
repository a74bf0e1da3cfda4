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
    """Return streams by name that may be lidars, as file and frame describe them together.

    The frame's words replace the file's."""
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
    """Find the cloud file of each sensor of a frame, by the sensor's name.

    file: the label file; content: its content; clouds: files below the folder by name; problems:
    counts of clouds that are missing or placed by a guess are added to it."""
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
    """Find the files of a frame's clouds: as it names them, by streams, else by its file's name.

    of_streams: stream of each cloud file that a uri names."""
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
    """Return the name of the stream of each cloud file that a stream's uri names."""
    streams: dict[Path, str] = {}
    for name, stream in _streams(content, frame).items():
        cloud = _find_cloud(str(stream.get("uri") or ""), file, clouds)
        if cloud is not None:
            streams.setdefault(cloud, name)
    return streams


def _find_cloud(location: str, labels: Path, clouds: CloudFiles) -> Path | None:
    """Find the cloud file that a label file names, None if it is not there.

    Among files of one name, it is the one with most folders in common. location: path or URL in
    the label file, of which the last part must be the file's name; labels: the label file."""
    candidates = clouds.get(PurePosixPath(location).name) or clouds.get(
        PureWindowsPath(location).name, ()
    )
    return max(candidates, key=lambda cloud: _common_tail(cloud, location, labels), default=None)


def _common_tail(cloud: Path, location: str, labels: Path) -> tuple[int, bool]:
    """Fit of a cloud file to the location in a label file, larger for a better fit.

    The first value is the number of equal parts at the paths' ends, the second True if cloud and
    labels are in folders of one name."""
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
    """Return the cloud file of each sensor, with sensors named by a stream or coordinate system.

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
    """Return the names of the coordinate systems that are sensors.

    These are the systems with "sensor" in their type, or, without such a system, those with a
    parent and no child."""
    of_type = [
        name for name, system in systems.items() if "sensor" in str(system.get("type")).lower()
    ]
    parents = {system.get("parent") for system in systems.values()}
    return of_type or [
        name for name, system in systems.items() if system.get("parent") and name not in parents
    ]
