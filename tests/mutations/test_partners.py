"""Recordings of which one file is gone, or of another time: refused in one line, or counted, and
never without a word.

Each layout of `layout_formats` is written once and read with one file away. A reading that says
nothing may only lack what was optional: what a frame then has is what it had before."""

import shutil
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

from toolkit.datasets.problem_kinds import STRAY
from toolkit.datasets.recordings import open_recording
from toolkit.frame import Frame

LAYOUTS = (
    *("folder", "kitti", "openlabel", "dair", "pair", "opv2v", "v2xset", "v2xreal"),
    *("rcooper", "nuscenes", "argoverse", "sustech", "ros2"),
)
NAMED = {"pair": "dair", "ros2": "rosbag"}
OPTIONAL = (
    "maps/",
    "v1.0-coview/scene",
    "v1.0-coview/map",
    "v1.0-coview/log",
    "attribute",
    "visibility",
)
# all labels or poses
ALONE = ("labels.json", "annotations.feather", "poses.txt", "cooperative/label_world/7.json")


@pytest.fixture
def write(monkeypatch) -> Callable[[str, Path], Path]:
    monkeypatch.setattr(sys, "path", [str(Path(__file__).parent), *sys.path])
    from layout_formats import write

    return write


def frames(layout: str, opened: Path) -> list[Frame]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return list(open_recording(opened, NAMED.get(layout, layout)))


def try_frames(layout: str, opened: Path) -> tuple[list[Frame], str]:
    """Frames of a recording, or what is said if it is refused."""
    try:
        return frames(layout, opened), ""
    except (ValueError, OSError) as error:
        return [], str(error)


def count(some: list[Frame]) -> list[tuple[int, int]]:
    return [(len(frame.points()), len(frame.objects)) for frame in some]


@pytest.mark.one_in(4)
@pytest.mark.parametrize("layout", LAYOUTS)
def test_one_file_is_gone(tmp_path, write, layout):
    opened = write(layout, tmp_path / "sound")
    sound = frames(layout, opened)
    files = sorted(file for file in (tmp_path / "sound").rglob("*") if file.is_file())
    silent = []
    for number, file in enumerate(files):
        name = file.relative_to(tmp_path / "sound").as_posix()
        place = tmp_path / str(number)
        shutil.copytree(tmp_path / "sound", place)
        (place / name).unlink()
        read, refused = try_frames(layout, place / opened.relative_to(tmp_path / "sound"))
        shutil.rmtree(place)
        assert "\n" not in refused
        if refused:
            continue
        said = any(
            frame.problems != before.problems for frame, before in zip(read, sound, strict=False)
        )
        same = count(read) == count(sound)
        whole_frame = len(read) < len(sound) and all(each in count(sound) for each in count(read))
        if not (said or same or whole_frame or name.startswith(OPTIONAL) or name in ALONE):
            silent.append(name)
    assert silent == []


@pytest.mark.parametrize("layout", ["folder", "kitti", "sustech"])
def test_labels_of_another_name_are_counted(tmp_path, write, layout):
    opened = write(layout, tmp_path)
    labels = {"folder": "labels.json", "kitti": "training/label_2", "sustech": "label"}[layout]
    if layout == "folder":
        text = (tmp_path / labels).read_text()
        (tmp_path / labels).write_text(text.replace('"000001"', '"1646667310044"'))
    else:
        (file,) = (tmp_path / labels).glob("000001.*")
        file.rename(file.with_name(f"1646667310044{file.suffix}"))
    read = frames(layout, opened)
    assert read[0].problems[STRAY] == 1
    assert sum("frames without labels" in kind for kind in read[1].problems) == 1
