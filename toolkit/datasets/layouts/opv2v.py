"""OPV2V, V2XSet and V2X-Real: SCENARIO/AGENT/00068.yaml and 00068.pcd.

There is a folder per vehicle or roadside unit. World frame: level, its origin at the first agent's
lidar, x in the lidar's direction; `map_SE3_world` is its pose in the map.

- OPV2V and V2XSet come from CARLA, whose world is **left-handed** (y right), and so are the points
  of their .pcd: here y is negated in both. V2X-Real is measured: its points and poses are
  right-handed and stay (layout `v2xreal`).
- lidar_pose is x y z **roll yaw pitch**, angles in **degrees**, turned as Unreal does; it may be a
  4×4 matrix.
- vehicles[id]: `extent` are **half** sizes, `angle` is roll yaw pitch, `center` is added to
  `location` unturned.
- Only objects that this agent's lidar hit are listed: an object that only another agent hit is in
  that agent's file. The agents' lists are put together by id.
- A roadside unit's folder has a negative number; intensity is in the first of a .pcd's colours.
- YAML 1.1 reads 1e-05 as a string."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from os.path import lexists
from pathlib import Path

import numpy as np

from toolkit.arrays import Pose
from toolkit.datasets import (
    box_frames,
    cloud_records,
    folders,
    frame_labels,
    listing,
    problem_kinds,
    record_values,
)
from toolkit.datasets.clock_times import UNPAIRED
from toolkit.datasets.record_values import entry, name_damage, numbers
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import invert, pose
from toolkit.runtime.reading import read_text
from toolkit.runtime.text_values import parse_yaml
from toolkit.runtime.writing import write_text

NO_YAML = "clouds of agents without their YAML file, left out"
SAME_NUMBER = "objects that two agents give one number and places far apart: the first is taken"
MAX_APART_M = 5.0  # between positions of one object at one tick, as two agents measure it
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


def opv2v(path: Path, *, left_handed: bool = True) -> listing.Listing:
    """Open all scenarios below a folder; a frame has the clouds of all agents at one tick.

    left_handed: True if files have y to the right, as CARLA's.
    Raises FileNotFoundError without any."""
    names: dict[str, list[Path]] = {}
    # clouds of agents; a scenario's files, such as data_protocol.yaml, are above
    clouds: dict[Path, set[str]] = {}
    labelled = list[str]()
    cloud_names = list[str]()
    described_stems: dict[Path, set[str]] = {}
    for file in folders.list_files(path, "*.yaml", recursive=True):
        if file.parent not in clouds:
            clouds[file.parent] = {
                cloud_file.stem
                for cloud_file in folders.list_files(file.parent)
                if cloud_file.suffix in folders.ENDINGS
            }
        file_name = file.with_suffix("").relative_to(path.parent).as_posix()
        labelled += [file_name] * bool(clouds[file.parent])
        described_stems.setdefault(file.parent, set()).add(file.stem)
        if file.stem in clouds[file.parent]:
            names.setdefault(
                (file.parent.parent / file.stem).relative_to(path.parent).as_posix(), []
            ).append(file)
            cloud_names.append(file_name)
    if not names:
        raise FileNotFoundError(
            f"{path} is no folder of OPV2V: it has no AGENT/*.yaml beside clouds of their names"
        )
    in_order = sorted(names.items(), key=lambda frame: folders.natural_order(frame[0]))
    agents = {name: sorted(files, key=_agent) for name, files in in_order}
    mirror = MIRROR if left_handed else np.eye(4)
    of_scenario: dict[Path, set[str]] = {}
    for file in (file for files in agents.values() for file in files):
        of_scenario.setdefault(file.parent.parent, set()).add(file.parent.name)
    undescribed_count = sum(
        len(stems - described_stems.get(agent, set()))
        for agent, stems in clouds.items()
        if agent in described_stems
    )

    counts = {scenario: len(members) for scenario, members in of_scenario.items()}
    load = partial(_load, agents, counts, mirror)
    noted = {NO_YAML: undescribed_count}
    return listing.Listing(tuple(agents), load, labelled=labelled, known=cloud_names, noted=noted)


v2xreal = partial(opv2v, left_handed=False)


def _agent(file: Path) -> tuple[int, int | str]:
    """Sort key of an agent's file: vehicles by number, then roadside units, then other names."""
    name = file.parent.name
    if not name.removeprefix("-").isdigit():
        return 2, name
    return int(name.startswith("-")), abs(int(name))


def _load(
    agents: Mapping[str, list[Path]], counts: Mapping[Path, int], mirror: np.ndarray, name: str
) -> Frame:
    """Load the frame of a name with the clouds of all agents.

    agents: YAML files of each frame's agents; counts: number of agents by folder of the scenario;
    mirror: (4, 4), turns the files' axes into right-handed ones."""
    files = agents[name]
    scenario = files[0].parent.parent  # a file is SCENARIO/AGENT/TICK.yaml
    problems: problem_kinds.Problems = {}
    problem_kinds.add_problem(problems, UNPAIRED, int(len(files) < counts[scenario]))
    return _read_frame(name, files, mirror, problems)


def _read_frame(
    name: str, files: list[Path], mirror: np.ndarray, problems: problem_kinds.Problems
) -> Frame:
    """Read a frame of OPV2V, in the frame of its first agent's lidar with z up.

    Args:
        name: Name of the frame.
        files: YAML file of each agent; its cloud is next to it.
        mirror: Matrix that turns the simulator's left-handed axes.
        problems: Problems of the recording, which the frame gets and adds to."""
    contents = []
    poses = []
    for file in files:
        with name_damage(file, "YAML file of an agent"):
            content = parse_yaml(read_text(file))
            if not isinstance(content, dict):
                raise ValueError(f"it must hold names and values, got {str(content)[:40]!r}")
            contents.append(content)
            poses.append(_parse_lidar_pose(entry(content, "lidar_pose"), mirror))
    x, y, z = poses[0][:3, 3]
    map_SE3_world = pose(x, y, z, yaw=float(box_frames.heading(poses[0], 0.0)))
    clouds: list[SensorCloud] = []
    rows: dict[object, np.ndarray] = {}
    turns: dict[object, np.ndarray] = {}
    apart_count = 0
    kinds: dict[object, str] = {}
    for file, content, map_SE3_lidar in zip(files, contents, poses, strict=True):
        recorded_file = next(
            file.with_suffix(end) for end in folders.ENDINGS if lexists(file.with_suffix(end))
        )
        cloud = cloud_records.read_cloud(
            recorded_file, file.parent.name, invert(map_SE3_world) @ map_SE3_lidar, problems
        )
        clouds.append(_mirror(cloud, mirror))
        with name_damage(file, "YAML file of an agent"):
            vehicles = content.get("vehicles") or {}
            if not isinstance(vehicles, dict):
                raise ValueError(
                    f"vehicles must be a mapping of ids to vehicles, got {str(vehicles)[:40]!r}"
                )
            for track, vehicle in vehicles.items():
                box, rotation = _parse_box(vehicle, mirror)
                first_box = rows.setdefault(track, box)
                turns.setdefault(track, rotation)
                apart_count += int(np.linalg.norm(first_box[:3] - box[:3]) > MAX_APART_M)
                kinds.setdefault(
                    track, str(vehicle.get("obj_type", vehicle.get("object_type", "Car")))
                )
    problem_kinds.add_problem(problems, SAME_NUMBER, apart_count)
    boxes = np.array(list(rows.values()), np.float64).reshape(-1, 7)
    boxes[:, 6] = box_frames.find_headings(
        np.array(list(turns.values())).reshape(-1, 3, 3), problems
    )
    boxes = box_frames.move_boxes(invert(map_SE3_world), boxes)
    labels = frame_labels.make_labels(boxes, list(kinds.values()), list(rows), problems)
    return Frame.of_clouds(
        name, tuple(clouds), *labels, map_SE3_world=map_SE3_world, problems=problems
    )


def _parse_lidar_pose(value: record_values.Unchecked, mirror: np.ndarray) -> Pose:
    """Pose (4, 4) of a lidar in the right-handed map.

    value: lidar_pose of a file, a 4×4 matrix or x y z (m) roll yaw pitch (degrees); mirror: (4, 4),
    turns the file's axes into right-handed ones."""
    if np.array(value, dtype=object).size == 16:
        lidar_pose = record_values.rigid_matrix(value, "lidar_pose")
    else:
        x, y, z, roll, yaw, pitch = numbers(value, 6, "lidar_pose")
        rotation = unreal_pose(roll_deg=roll, yaw_deg=yaw, pitch_deg=pitch)[:3, :3]
        lidar_pose = record_values.rigid(rotation, [x, y, z], "lidar_pose")
    return mirror @ lidar_pose @ mirror


def unreal_pose(roll_deg: float, yaw_deg: float, pitch_deg: float) -> Pose:
    """Pose (4, 4) at the origin with Unreal's angles (degrees), in its left-handed axes.

    It turns by yaw about z, then pitch, which lifts x, then roll."""
    return pose(yaw=np.deg2rad(yaw_deg), pitch=-np.deg2rad(pitch_deg), roll=-np.deg2rad(roll_deg))


def _parse_box(
    vehicle: record_values.Unchecked, mirror: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Box (7 numbers) of a vehicle in the right-handed map with a yaw of 0, and its rotation.

    The rotation is (3, 3). vehicle: entry of a file; mirror: (4, 4), turns the file's axes into
    right-handed ones."""
    location = numbers(entry(vehicle, "location"), 3, "location")
    offset = numbers(entry(vehicle, "center"), 3, "center")  # not turned with the vehicle
    centre = mirror[:3, :3] @ (location + offset)
    roll, yaw, pitch = numbers(entry(vehicle, "angle"), 3, "angle")
    size = 2 * numbers(entry(vehicle, "extent"), 3, "extent")  # from half sizes
    rotation = mirror @ unreal_pose(roll_deg=roll, yaw_deg=yaw, pitch_deg=pitch) @ mirror
    return np.array([*centre, *size, 0.0]), rotation[:3, :3]


def _mirror(cloud: SensorCloud, mirror: np.ndarray) -> SensorCloud:
    return replace(cloud, points=cloud.points * np.diag(mirror)[:3].astype(np.float32))


def write_opv2v(samples: Iterable[Frame], folder: Path, *, left_handed: bool = True) -> None:
    """Write frames as a scenario. Each sensor is an agent, from 0, that lists all objects.

    left_handed: in Unreal's axes, with y mirrored, as the data set has them."""
    import yaml

    mirror = MIRROR if left_handed else np.eye(4)
    for number, sample in enumerate(samples):
        name = f"{number:05d}"
        file_from_world = mirror @ sample.map_SE3_world
        vehicles = {}
        for box, kind, track in frame_labels.list_rows(sample.objects, frame_labels.COMMON_NAMES):
            centre, size = box[:3], box[3:6]
            yaw = box[6]
            file_yaw = float(np.rad2deg(box_frames.heading(file_from_world, yaw)))
            vehicles[track] = {
                "angle": [0.0, file_yaw, 0.0],
                "center": [0.0] * 3,
                "location": (file_from_world[:3, :3] @ centre + file_from_world[:3, 3]).tolist(),
                "extent": [side / 2 for side in size],
                "obj_type": kind,
            }
        for agent, cloud in enumerate(sample.clouds):
            lidar_pose = file_from_world @ cloud.world_SE3_sensor @ mirror
            # as Unreal has them
            roll = np.arctan2(-lidar_pose[2, 1], lidar_pose[2, 2])
            yaw = np.arctan2(lidar_pose[1, 0], lidar_pose[0, 0])
            pitch = np.arcsin(np.clip(lidar_pose[2, 0], -1, 1))
            angles = np.rad2deg([roll, yaw, pitch]).tolist()
            content = {"lidar_pose": [*lidar_pose[:3, 3].tolist(), *angles], "vehicles": vehicles}
            cloud_records.write_cloud(
                folder / "scenario" / str(agent) / f"{name}.pcd",
                _mirror(cloud.in_own_frame(), mirror),
            )
            write_text(folder / "scenario" / str(agent) / f"{name}.yaml", yaml.safe_dump(content))


write_v2xreal = partial(write_opv2v, left_handed=False)
