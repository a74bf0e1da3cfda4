"""RCooper: data/SCENE/AGENT/SEQUENCE/lidar/*.pcd, label/SCENE/AGENT/SEQUENCE/*.json,
calib/lidar2world/AGENT.json.

World frame: lidar2world's, the same for all agents (poles) of a scene; right-handed, z up. Each
agent's labels are in its lidar's frame and cover the objects that it sees; label/SCENE/coop is not
read. Each agent numbers its tracks separately: boxes of one class that two agents list and that
overlap are one object, the first agent's.

- SCENE lists its agents, "117-118-120-119"; files are named by their time in seconds and differ by
  milliseconds between agents: files of one time are one frame. Only if names are no times, the k-th
  of one belongs to the k-th of others.
- Labels are as in DAIR-V2X: centre, l w h, yaw about z in radians, numbers or strings.
- lidar2world turns by a matrix that is not quite a rotation."""

from collections.abc import Mapping, Sequence
from functools import partial
from os.path import lexists
from pathlib import Path

import numpy as np

from toolkit.arrays import Float64, Int64
from toolkit.boxes import iou_bev
from toolkit.datasets.clock_times import BY_ORDER, UNPAIRED, find_epoch, group_by_time
from toolkit.datasets.cloud_records import read_cloud
from toolkit.datasets.folders import ENDINGS, NameOrder, list_files, natural_order
from toolkit.datasets.frame_times import frame_time
from toolkit.datasets.layouts.dair import read_annotations, read_transform
from toolkit.datasets.listing import Listing
from toolkit.datasets.problem_kinds import UNLABELLED, Problems, add_problem
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import Objects

SAME_OBJECT_IOU = 0.3  # BEV IoU; two agents' labels of one class above it are one object


def rcooper(path: Path) -> Listing:
    """Frames of the whole data set, each of all agents.

    Raises FileNotFoundError if the folder is no such data set."""
    names: dict[str, list[tuple[str, Path]]] = {}
    noted: dict[str, Problems] = {}
    labelled = list[str]()
    cloud_names = list[str]()
    for scene in list_files(path / "data"):
        agents = [name for name in scene.name.split("-") if (scene / name).is_dir()]
        for sequence in sorted(
            {
                folder.name
                for name in agents
                for folder in (scene / name).iterdir()
                if folder.is_dir()
            }
        ):
            files = [(name, _clouds(scene / name / sequence / "lidar")) for name in agents]
            for name, agent_files in files:
                relative_name = f"{scene.name}/{name}/{sequence}"
                cloud_names += [f"{relative_name}/{file.stem}" for file in agent_files]
                labelled += [
                    f"{relative_name}/{file.stem}"
                    for file in list_files(path / "label" / relative_name, "*.json")
                ]
            groups, by_order = _match(dict(files))
            for k, group in enumerate(groups):
                name = f"{scene.name}/{sequence}/{k:05d}"
                names[name] = list(group.items())
                noted[name] = {UNPAIRED: int(len(group) < len(agents)), BY_ORDER: int(by_order)}
    if not names:
        raise FileNotFoundError(
            f"{path} is no RCooper folder: it has no data/SCENE/AGENT/SEQUENCE/lidar/*.pcd"
        )

    load = partial(_read_frame, path, names, noted, bool(labelled))
    return Listing(tuple(names), load, labelled=labelled, known=cloud_names)


def _match(files: Mapping[str, Sequence[Path]]) -> tuple[list[dict[str, Path]], bool]:
    """Cloud files of each frame by agent, and True if their order put them together.

    files: cloud files of each agent in order. They are put together by time if all names are
    times."""
    times = {agent: _list_times(agent_files) for agent, agent_files in files.items()}
    if all(np.isfinite(stamps).all() for stamps in times.values()):
        return [_take(files, group) for group in group_by_time(times)], False
    # the k-th files of all agents, as far as every agent has one
    count = min((len(agent_files) for agent_files in files.values()), default=0)
    return [_take(files, dict.fromkeys(files, k)) for k in range(count)], len(files) > 1


def _list_times(files: Sequence[Path]) -> Float64[np.ndarray, " n"]:
    return np.array([_time(file)[0] for file in files])


def _take(files: Mapping[str, Sequence[Path]], rows: Mapping[str, int]) -> dict[str, Path]:
    """Cloud file of each agent; rows: its index among the agent's files."""
    return {agent: files[agent][row] for agent, row in rows.items()}


def _clouds(folder: Path) -> list[Path]:
    return sorted(
        (file for file in list_files(folder) if file.suffix.lower() in ENDINGS), key=_time
    )


def _time(file: Path) -> tuple[float, NameOrder]:
    """Key that sorts files by the time in their names, and those without a time after them."""
    try:
        return float(file.stem), natural_order(file.stem)
    except ValueError:
        return float("inf"), natural_order(file.stem)


def _read_frame(
    root: Path,
    clouds_of: Mapping[str, list[tuple[str, Path]]],
    noted: Mapping[str, Problems],
    is_labelled: bool,
    name: str,
) -> Frame:
    """Read the frame of a name, SCENE/SEQUENCE/NUMBER.

    root: folder of the data set; clouds_of: agents and cloud files of each frame by name; noted:
    problems of each frame; is_labelled: True if the data set has labels, so that a cloud without
    them counts as a problem."""
    problems = {kind: count for kind, count in noted[name].items() if count}
    scene, sequence, _ = name.split("/")
    clouds: list[SensorCloud] = []
    objects_of_agents: list[Objects] = []
    categories: list[str] = []  # for all objects, one agent after the other
    for agent, file in clouds_of[name]:
        pose = read_transform(root / "calib" / "lidar2world" / f"{agent}.json")
        clouds.append(read_cloud(file, agent, pose, problems, stamp_s=find_epoch(file.stem)))
        label_file = root / "label" / scene / agent / sequence / f"{file.stem}.json"
        has_labels = lexists(label_file)
        add_problem(problems, UNLABELLED, int(is_labelled and not has_labels))
        labels = read_annotations(label_file if has_labels else None, pose, problems)
        objects_of_agents.append(labels.objects)
        categories += labels.categories
    objects, rows = merge_copies(objects_of_agents)
    return Frame.of_clouds(
        name,
        clouds,
        objects,
        categories=tuple(categories[row] for row in rows),
        time=frame_time(clouds),
        problems=problems,
    )


def merge_copies(parts: list[Objects]) -> tuple[Objects, Int64[np.ndarray, " n"]]:
    """Merge several agents' objects: of copies of one object, only the first agent's is kept.

    Returns the objects, and their rows among the objects of all agents one after the other. parts:
    objects of each agent. Objects of one class that overlap are copies."""
    boxes = np.concatenate([np.zeros((0, 7)), *(objects.boxes for objects in parts)])
    labels = np.concatenate([np.zeros(0, np.int64), *(objects.labels for objects in parts)])
    ids = np.concatenate([np.zeros(0, np.int64), *(objects.ids for objects in parts)])
    agent = np.repeat(np.arange(len(parts)), [len(objects) for objects in parts])
    # masks of pairs of objects
    have_one_label = labels[:, None] == labels
    have_two_agents = agent[:, None] != agent
    are_copies = (iou_bev(boxes, boxes) > SAME_OBJECT_IOU) & have_one_label & have_two_agents
    kept_rows: list[int] = []
    for row in range(len(boxes)):
        if not are_copies[row, kept_rows].any():
            kept_rows.append(row)
    rows = np.array(kept_rows, np.int64)
    return Objects(boxes[rows], labels=labels[rows], ids=ids[rows]), rows
