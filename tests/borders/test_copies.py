"""Copies of environments, planners, objectives, renderers and recordings.

The contract is Python's: `copy.deepcopy` and `pickle` give an equal object that shares no state
with the original (docs.python.org/3/library/copy.html, library/pickle.html)."""

import copy
import pickle
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from placement_env.envs.registration import ENVIRONMENTS, register_environments
from placement_env.live.planner import LivePlanner
from placement_env.objective import Objective
from placement_env.setting import Setting
from toolkit import load_site
from toolkit.bodies.fleet import fleet_named
from toolkit.datasets.recording_views import Part, ReadRecording
from toolkit.datasets.recordings import open_recording, write_recording
from toolkit.frame import Frame, SensorCloud
from toolkit.geometry import pose
from toolkit.objects import Objects
from toolkit.rendering.renderer import Renderer
from toolkit.runtime.run import Run

register_environments()
FEW = {"frames": 2, "fidelity": "coverage", "budget": 2}
COPIES = {
    "deepcopy": copy.deepcopy,
    "pickle": lambda original: pickle.loads(pickle.dumps(original)),
}
both_ways = pytest.mark.parametrize("duplicate", COPIES.values(), ids=COPIES)
# copies of vectors are copies of their environments
scalar_quickly = pytest.mark.parametrize(
    "vector", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["scalar", "vector"]
)

STEP_ELSEWHERE = """
import pickle, sys
with open(sys.argv[1], "rb") as file:
    env, action = pickle.load(file)
with open(sys.argv[2], "wb") as file:
    pickle.dump(env.step(action), file)
"""


def start(name: str, *, vector: bool):
    """An environment after two steps, and a function that draws actions."""
    env = (
        gym.make_vec(name, num_envs=2, **FEW)
        if vector
        else gym.make(name, disable_env_checker=True, **FEW)
    )
    rng = np.random.default_rng(7)

    def draw_action():
        mask = np.atleast_2d(env.unwrapped.action_masks())
        if "Pose" in name:
            return rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        if "Subset" in name:
            return rng.integers(2, size=env.action_space.shape).astype(np.int8)
        choices = np.array([rng.choice(np.flatnonzero(row)) for row in mask])
        return choices if vector else choices[0]

    env.reset(seed=3)
    env.step(draw_action())
    return env, draw_action


def is_same(one, other) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(one[:4], other[:4], strict=True))


@pytest.mark.one_in(3)
@both_ways
@scalar_quickly
@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_a_copied_environment_goes_its_own_way(name, vector, duplicate):
    env, draw_action = start(name, vector=vector)
    first, second, other = draw_action(), draw_action(), draw_action()
    follower, stray = duplicate(env), duplicate(env)
    stray.step(other)
    stray.reset(seed=11)
    after = env.step(first)
    assert is_same(after, follower.step(first))
    assert is_same(env.step(second), follower.step(second))
    assert np.array_equal(env.reset()[0], follower.reset()[0])  # the generators continue alike


def test_a_pickled_environment_steps_in_a_fresh_process(tmp_path: Path):
    env, draw_action = start("coview/SensorPose-v0", vector=False)
    action = draw_action()
    (tmp_path / "env").write_bytes(pickle.dumps((env, action)))
    command = [sys.executable, "-c", STEP_ELSEWHERE, str(tmp_path / "env"), str(tmp_path / "out")]
    subprocess.run(command, check=True, timeout=120, capture_output=True)
    assert is_same(env.step(action), pickle.loads((tmp_path / "out").read_bytes()))


def test_panoramas_are_shared_by_copies_and_go_along_when_pickled():
    env, _ = start("coview/SensorPose-v0", vector=False)
    live = env.unwrapped.task.episodes[0].preparation.live
    copied, pickled = (duplicate(live) for duplicate in COPIES.values())
    place, surround = next(iter(live.surrounds.items()))
    assert copied.surrounds[place] is surround
    assert pickled.surrounds.keys() == live.surrounds.keys()
    assert len({id(each.casting) for each in (live, copied, pickled)}) == 3
    copied.surrounds.clear()
    assert len(live.surrounds)


@pytest.mark.one_in(2)
@both_ways
def test_a_copied_planner_goes_its_own_way(duplicate):
    planner, changes = LivePlanner("tjunction", frames=2), []
    planner.listen(changes.append)
    name = planner.sensors[0].name
    planner.move(name, heading=0.4)
    told = len(changes)
    copied = duplicate(planner)
    copied.move(name, heading=2.0)
    copied.undo()
    copied.undo()
    assert len(changes) == told
    assert planner.sensors[0].heading == pytest.approx(0.4)
    again = duplicate(planner)
    here, there = planner.move(name, tilt=0.5), again.move(name, tilt=0.5)
    assert (here.ap, here.change, here.coarse) == (there.ap, there.change, there.coarse)
    assert planner.finish().ap == again.finish().ap


@both_ways
@pytest.mark.parametrize("fidelity", ["coverage", "surrogate", "table"])
def test_a_copied_objective_scores_alike(fidelity, duplicate):
    objective = Objective(Setting("tjunction", fidelity=fidelity), Run(frames=2))
    assert duplicate(objective).score([0, 2]) == objective.score([0, 2])
    assert duplicate(objective).score([1]) == objective.score([1])


@both_ways
def test_a_copied_renderer_measures_alike(duplicate):
    site = load_site("tjunction")
    bodies = fleet_named("catalogue").bodies(1, np.random.default_rng(0))[:2]
    renderer = Renderer(site, bodies, site.sensors[:1], threads=1)
    for image, again in zip(renderer.background, duplicate(renderer).background, strict=True):
        assert np.array_equal(image, again)


def frames(count: int = 3) -> list[Frame]:
    rng = np.random.default_rng(1)
    made = []
    for k in range(count):
        points = rng.uniform(-8, 8, (200, 3)).astype(np.float32)
        boxes = np.array([[4.0 + k, 0.0, -4.0, 4.0, 1.8, 1.6, 0.1]])
        cloud = SensorCloud("north", points, pose(0.0, 0.0, 5.0))
        made.append(
            Frame.of_clouds(f"{1700000000 + k}000000000", (cloud,), Objects(boxes), time=float(k))
        )
    return made


LAYOUTS = [
    "folder",
    "kitti",
    "openlabel",
    "dair",
    "opv2v",
    "v2xset",
    "v2xreal",
    "nuscenes",
    "argoverse",
    "sustech",
]
LAYOUTS += ["rosbag", "hdf5"]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_copied_recording_has_the_same_frames(layout, tmp_path: Path):
    path = tmp_path / ("clouds.hdf5" if layout == "hdf5" else "recording")
    write_recording(frames(), path, layout)
    recording = open_recording(path / "bag" if layout == "rosbag" else path, layout)
    first = recording[0]
    for duplicate in COPIES.values():
        for view in (recording, Part(recording, frames=2), ReadRecording(recording)):
            copied = duplicate(view)
            assert len(copied) == len(view)
            for frame, expected in ((copied[1], recording[1]), (copied[0], first)):
                assert frame.name == expected.name
                assert np.array_equal(frame.clouds[0].points, expected.clouds[0].points)
                assert np.array_equal(frame.objects.boxes, expected.objects.boxes)
