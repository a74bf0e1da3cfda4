"""RCooper: data/SCENE/AGENT/SEQUENCE/lidar/*.pcd, label/SCENE/AGENT/SEQUENCE/*.json,
calib/lidar2world/AGENT.json.

World frame: lidar2world's, in which all agents (poles) of a scene stand; right-handed, z up. Each
agent's labels are in its own lidar's frame and say what that agent sees; label/SCENE/coop is not
read. Tracks are numbered by each agent for itself: boxes of one class that two agents list and that
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

from toolkit.arrays import Int64
from toolkit.boxes import iou_bev
from toolkit.datasets.clock_times import BY_ORDER, UNPAIRED, find_epoch, group_by_time
from toolkit.datasets.layouts.dair import read_annotations, read_transform
from toolkit.datasets.records import (
    ENDINGS,
    UNLABELLED,
    Listing,
    Problems,
    add_problem,
    frame_time,
    list_files,
    natural_order,
    read_cloud,
)
from toolkit.frame import Frame, SensorCloud
from toolkit.objects import Objects

SAME_OBJECT = 0.3  # BEV IoU; two agents' labels of one class above it are one object


def rcooper(path: Path) -> Listing:
    """Frames of the whole set, each of all agents. Raises FileNotFoundError if the folder is not
    such a set."""
    names: dict[str, list[tuple[str, Path]]] = {}
    noted: dict[str, Problems] = {}
    labelled = list[str]()
    known = list[str]()
    for scene in list_files(path / "data"):
        agents = [name for name in scene.name.split("-") if (scene / name).is_dir()]
        for sequence in sorted(
            {each.name for name in agents for each in (scene / name).iterdir() if each.is_dir()}
        ):
            files = [(name, _clouds(scene / name / sequence / "lidar")) for name in agents]
            for name, some in files:
                own = f"{scene.name}/{name}/{sequence}"
                known += [f"{own}/{file.stem}" for file in some]
                labelled += [
                    f"{own}/{file.stem}" for file in list_files(path / "label" / own, "*.json")
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

    load = partial(_sample, path, names, noted, bool(labelled))
    return Listing(tuple(names), load, labelled=labelled, known=known)


def _match(files: Mapping[str, Sequence[Path]]) -> tuple[list[dict[str, Path]], bool]:
    """Clouds of each frame by agent, and whether their order put them together."""
    times = {agent: np.array([_time(file)[0] for file in some]) for agent, some in files.items()}
    if all(np.isfinite(each).all() for each in times.values()):
        return [_take(files, group) for group in group_by_time(times)], False
    count = min((len(clouds) for clouds in files.values()), default=0)
    return [_take(files, dict.fromkeys(files, k)) for k in range(count)], len(files) > 1


def _take(files: Mapping[str, Sequence[Path]], rows: Mapping[str, int]) -> dict[str, Path]:
    """Clouds of these numbers by agent."""
    return {agent: files[agent][row] for agent, row in rows.items()}


def _clouds(folder: Path) -> list[Path]:
    return sorted(
        (file for file in list_files(folder) if file.suffix.lower() in ENDINGS), key=_time
    )


def _time(file: Path) -> tuple[float, tuple[str | int, ...]]:
    try:
        return float(file.stem), natural_order(file.stem)
    except ValueError:
        return float("inf"), natural_order(file.stem)


def _sample(
    root: Path,
    clouds_of: Mapping[str, list[tuple[str, Path]]],
    noted: Mapping[str, Problems],
    is_labelled: bool,
    name: str,
) -> Frame:
    files = clouds_of[name]
    problems = {kind: count for kind, count in noted[name].items() if count}
    scene, sequence, _ = name.split("/")
    clouds: list[SensorCloud] = []
    parts: list[Objects] = []
    categories: list[str] = []
    for agent, file in files:
        pose = read_transform(root / "calib" / "lidar2world" / f"{agent}.json")
        clouds.append(read_cloud(file, agent, pose, problems, stamp_s=find_epoch(file.stem)))
        labels = root / "label" / scene / agent / sequence / f"{file.stem}.json"
        is_there = lexists(labels)
        add_problem(problems, UNLABELLED, int(is_labelled and not is_there))
        found = read_annotations(labels if is_there else None, pose, problems)
        parts.append(found.objects)
        categories += found.categories
    objects, rows = merged(parts)
    kept = tuple(categories[k] for k in rows)
    return Frame.of_clouds(name, clouds, objects, kept, time=frame_time(clouds), problems=problems)


def merged(parts: list[Objects]) -> tuple[Objects, Int64[np.ndarray, " n"]]:
    """Merge several agents' objects into one list. Returns it and its rows among all of them."""
    boxes = np.concatenate([np.zeros((0, 7)), *(part.boxes for part in parts)])
    labels = np.concatenate([np.zeros(0, np.int64), *(part.labels for part in parts)])
    ids = np.concatenate([np.zeros(0, np.int64), *(part.ids for part in parts)])
    agent = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    same = (
        (iou_bev(boxes, boxes) > SAME_OBJECT)
        & (labels[:, None] == labels)
        & (agent[:, None] != agent)
    )
    kept: list[int] = []
    for k in range(len(boxes)):
        if not same[k, kept].any():
            kept.append(k)
    rows = np.array(kept, np.int64)
    return Objects(boxes[rows], labels[rows], ids[rows]), rows
