import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from toolkit.bodies.fleet import Fleet, catalogue, fleet_named
from toolkit.boxes import points_in_boxes
from toolkit.datasets import simulation
from toolkit.datasets.dataset import CoopDataset
from toolkit.datasets.simulation import FRAMES_PER_BLOCK, simulate_dataset
from toolkit.geometry import transform
from toolkit.objects import HEAVY, LABELS, VEHICLE
from toolkit.runtime.run import Run
from toolkit.sensors.models import DepthCamera, SpinningLidar
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site

pytest.importorskip("libsumo")

REPOSITORY = Path(__file__).parents[3]
FRAMES = 2 * FRAMES_PER_BLOCK + 10

# A small job, for this process and for ones that get killed: few bodies, few pixels.
SCRIPT = """
import resource, sys
from pathlib import Path
from tests.toolkit.datasets.test_simulation import small_job
from toolkit.datasets.simulation import simulate_dataset

if __name__ == "__main__":
    out, workers, limit = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    if limit:
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    try:
        simulate_dataset(out=out, **small_job(workers=workers))
    except OSError as error:
        sys.exit(str(error))
"""


def small_job(**changes):
    site = load_site("tjunction")
    first, second = site.sensors[:2]
    small = DepthCamera(width=80, height=60)
    sensors = (Sensor("a", small, first.pose), Sensor("b", small, second.pose))
    bodies = [body for body in catalogue() if body.label in (VEHICLE, HEAVY)][::5]
    numbers = {"frames": FRAMES, "seed": 3, "workers": 1, **changes}
    asked = Run(
        **{
            name: numbers.pop(name)
            for name in ("frames", "seed", "workers", "progress")
            if name in numbers
        }
    )
    return {
        "site": site,
        "run": asked,
        "sensors": sensors,
        "fleet": Fleet(tuple(bodies)),
        **numbers,
    }


def run(tmp_path: Path, out: Path, workers: int = 1, limit: int = 0) -> subprocess.Popen:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    return subprocess.Popen(
        [sys.executable, "-B", str(script), str(out), str(workers), str(limit)],
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(REPOSITORY), os.environ.get("PYTHONPATH", "")]),
        },
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The small job, done in this process without a break."""
    out = tmp_path_factory.mktemp("undisturbed") / "recording.hdf5"
    told: list[int] = []
    assert (
        simulate_dataset(out=out, **small_job(progress=lambda _, done, total: told.append(done)))
        == FRAMES
    )
    assert told == list(range(1, FRAMES + 1))
    assert [path.name for path in out.parent.iterdir()] == [out.name]
    return out


def test_frames_and_bodies_of_a_simulated_dataset(undisturbed):
    dataset = CoopDataset(undisturbed)
    job = small_job()
    assert len(dataset) == FRAMES
    assert dataset.sensors == job["sensors"]
    assert dataset.site == job["site"]
    assert {frame.time for frame in dataset} == set(np.arange(FRAMES) * 5.0)
    tracks = [set(frame.objects.ids.tolist()) for frame in dataset]
    assert tracks[FRAMES_PER_BLOCK - 1].isdisjoint(tracks[FRAMES_PER_BLOCK])
    assert tracks[FRAMES_PER_BLOCK] & tracks[FRAMES_PER_BLOCK + 1]
    assert len({frame.objects.boxes.tobytes() for frame in dataset}) == FRAMES
    assert np.mean([len(frame.objects) for frame in dataset]) > 3
    sizes = np.array([body.size for body in small_job()["fleet"].fixed])
    with h5py.File(undisturbed) as file:
        bodies, start = file["coview/object_bodies"][:], file["coview/object_start"][:]
        for k in (0, FRAMES - 1):
            halves = file[f"objects/{k}"][:, 6:9]
            assert np.allclose(2 * halves, sizes[bodies[start[k] : start[k + 1]]], atol=1e-3)


def test_points_lie_in_boxes_and_what_is_complete_stays(undisturbed):
    """What differs from the picture of the empty junction is on an object."""
    dataset = CoopDataset(undisturbed)
    empty = [np.max([frame.images[i] for frame in dataset], axis=0) for i in range(2)]
    seen = inside = 0
    for frame in dataset[::10]:
        boxes = frame.objects.boxes.copy()
        boxes[:, 3:6] += 0.04
        for sensor, measurement, background in zip(frame.sensors, frame.images, empty, strict=True):
            moving = (measurement > 0) & (measurement < background - 0.5)
            rays = sensor.model.rays()[moving]
            points = transform(
                sensor.pose, (rays * measurement[moving][:, None]).astype(np.float64)
            )
            seen += len(points)
            inside += int(points_in_boxes(points, boxes).any(axis=1).sum())
    assert seen > 200
    assert inside >= 0.98 * seen  # what lies outside are wing mirrors
    before = undisturbed.stat().st_mtime_ns
    (undisturbed.parent / "recording.hdf5.parts").mkdir()  # as if it was killed while cleaning up
    assert simulate_dataset(out=undisturbed, **small_job()) == 0
    assert undisturbed.stat().st_mtime_ns == before
    assert [path.name for path in undisturbed.parent.iterdir()] == [undisturbed.name]


def test_as_many_workers_as_you_like_write_the_same_bytes(tmp_path, undisturbed):
    out = tmp_path / "out.hdf5"
    assert simulate_dataset(out=out, **small_job(workers=2)) == FRAMES
    assert out.read_bytes() == undisturbed.read_bytes()


def test_killed_and_started_again_it_writes_the_same_bytes(tmp_path, undisturbed):
    out = tmp_path / "out.hdf5"
    process = run(tmp_path, out)
    while not list(tmp_path.glob("out.hdf5.parts/00000.*.hdf5")):
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.01)
    time.sleep(0.2)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not out.exists()
    assert len(CoopDataset(next(tmp_path.glob("out.hdf5.parts/00000.*.hdf5")))) == FRAMES_PER_BLOCK
    told: list[int] = []
    made = simulate_dataset(out=out, **small_job(progress=lambda _, done, total: told.append(done)))
    assert made in (FRAMES - FRAMES_PER_BLOCK, FRAMES - 2 * FRAMES_PER_BLOCK)
    assert told[0] == FRAMES - made + 1
    assert out.read_bytes() == undisturbed.read_bytes()


@pytest.mark.one_in(2)
@pytest.mark.parametrize("share", [0.1, 0.8])
def test_no_room_on_the_disk(tmp_path, undisturbed, share):
    """A file may not grow beyond a share of what is needed: too little for a part, and enough for
    parts alone."""
    out = tmp_path / "out.hdf5"
    process = run(tmp_path, out, limit=int(undisturbed.stat().st_size * share))
    says = process.communicate()[1].strip()
    assert process.returncode == 1
    assert "\n" not in says
    safe = 0 if share < 0.5 else FRAMES
    assert f"cannot write {out}: File too large" in says
    assert f"{safe} frames are safe in {out}.parts, make room and start again to go on" in says
    assert not out.exists()
    assert not list(tmp_path.glob("out.hdf5.parts/*.unfinished"))
    assert simulate_dataset(out=out, **small_job()) == FRAMES - safe
    assert out.read_bytes() == undisturbed.read_bytes()


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        *(({"seed": 4}, "seed 3 instead of 4"), ({"frames": 7}, f"frames {FRAMES} instead of 7")),
        ({"sensors": small_job()["sensors"][:1]}, "sensors 2 .* instead of 1 "),
        ({"fleet": Fleet(small_job()["fleet"].fixed[:3])}, "bodies . .* instead of 3 "),
    ],
)
def test_what_was_made_from_something_else_is_not_touched(undisturbed, changes, says):
    before = undisturbed.read_bytes()
    with pytest.raises(
        FileExistsError, match=f"exists, made from {says}.*: write to another file, or --overwrite"
    ):
        simulate_dataset(out=undisturbed, **small_job(**changes))
    assert undisturbed.read_bytes() == before
    assert [path.name for path in undisturbed.parent.iterdir()] == [undisturbed.name]


def test_files_of_others_are_not_overwritten(tmp_path):
    out = tmp_path / "thesis.txt"
    out.write_text("ten years")
    with pytest.raises(FileExistsError, match="is no complete file of coview simulate"):
        simulate_dataset(out=out, **small_job())
    assert out.read_text() == "ten years"


def test_another_job_overwrites_when_told_to(tmp_path):
    out = tmp_path / "new" / "out.hdf5"
    site = load_site("tjunction")
    lidar = Sensor("lidar", SpinningLidar(channels=4, azimuth_step=0.1), site.sensors[0].pose)
    job, other = (
        small_job(frames=2, sensors=(lidar,)),
        small_job(frames=2, sensors=(lidar,), seed=4),
    )
    assert simulate_dataset(out=out, **job) == 2
    assert simulate_dataset(out=out, overwrite=True, **other) == 2
    assert CoopDataset(out).sensors == (lidar,)
    assert simulate_dataset(out=out, **other) == 0


def test_links_are_followed(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    link, real = tmp_path / "out.hdf5", tmp_path / "elsewhere" / "real.hdf5"
    link.symlink_to(real)
    assert simulate_dataset(out=link, **small_job(frames=np.int64(1), seed=np.int32(3))) == 1
    assert link.is_symlink()
    assert len(CoopDataset(real)) == 1
    assert simulate_dataset(out=link, **small_job(frames=1)) == 0
    assert [path.name for path in (tmp_path / "elsewhere").iterdir()] == ["real.hdf5"]


a, b = small_job()["sensors"]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        *(({"sensors": ()}, "has no sensors"), ({"sensors": (a, a)}, "different names")),
        ({"sensors": (Sensor("a/b", a.model, a.pose),)}, "without '/'"),
    ],
)
def test_arguments_that_do_not_fit_leave_nothing(tmp_path, changes, says):
    with pytest.raises(
        (ValueError, TypeError), match=f"{says}|Type-check error"
    ):  # the shape checker may come first
        simulate_dataset(out=tmp_path / "new" / "out.hdf5", **small_job(**changes))
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_ray_cluster_writes_the_same_bytes(tmp_path, undisturbed):
    pytest.importorskip("ray")
    job = small_job()
    told: list[int] = []
    on_ray = replace(job["run"], ray="local", progress=lambda _, done, total: told.append(done))
    assert simulate_dataset(out=tmp_path / "out.hdf5", **{**job, "run": on_ray}) == FRAMES
    assert (tmp_path / "out.hdf5").read_bytes() == undisturbed.read_bytes()
    assert told == [FRAMES_PER_BLOCK, 2 * FRAMES_PER_BLOCK, FRAMES]


@pytest.mark.slow
def test_progress_is_told_while_processes_work(tmp_path):
    told: list[int] = []
    job = small_job(workers=2, progress=lambda _, done, total: told.append(done))
    simulate_dataset(out=tmp_path / "out.hdf5", **job)
    assert told == sorted(told)
    assert told[-1] == FRAMES


@pytest.mark.slow
def test_a_drawn_fleet_gives_everyone_a_body_of_its_own_and_the_same_bytes_after_a_break(
    tmp_path, limits
):
    limits(simulation, FRAMES_PER_BLOCK=5)
    job = small_job(frames=8, fleet=fleet_named("own"))
    whole, resumed = tmp_path / "whole.hdf5", tmp_path / "resumed.hdf5"

    def broken_off(_, done, total):
        if done == 6:
            raise KeyboardInterrupt

    assert simulate_dataset(out=whole, **job) == 8
    with pytest.raises(KeyboardInterrupt):
        simulate_dataset(out=resumed, **{**job, "run": replace(job["run"], progress=broken_off)})
    assert simulate_dataset(out=resumed, **job) == 3
    assert resumed.read_bytes() == whole.read_bytes()
    with h5py.File(whole) as file:
        names, numbers = json.loads(file["coview/bodies"][()]), file["coview/object_bodies"][:]
        ids, halves = (
            file["coview/object_ids"][:],
            np.concatenate([file[f"objects/{k}"][:, 6:9] for k in range(8)]),
        )
        plan = json.loads(file["coview"].attrs["plan"])
    labels = np.concatenate([frame.objects.labels for frame in CoopDataset(whole)])
    assert [names[number].split("/")[0] for number in numbers] == [
        LABELS[label] for label in labels
    ]
    sizes = {
        name: {tuple(size) for size in halves[ids == name].round(6)} for name in set(ids.tolist())
    }
    assert all(len(each) == 1 for each in sizes.values())
    assert len(set.union(*sizes.values())) == len(sizes) > 60
    assert "drawn vehicle cyclist pedestrian heavy without mirrors" in plan["bodies"]
    with pytest.raises(FileExistsError, match=r"without mirrors .* instead of .* with mirrors"):
        simulate_dataset(out=whole, **{**job, "fleet": fleet_named("own", mirrors=True)})


def test_frames_a_tenth_of_a_second_apart(tmp_path):
    job = small_job(frames=FRAMES_PER_BLOCK + 2, interval=0.1)
    simulate_dataset(out=tmp_path / "close.hdf5", **job)
    with CoopDataset(tmp_path / "close.hdf5") as close:
        np.testing.assert_allclose(
            [frame.time for frame in close], 0.1 * np.arange(FRAMES_PER_BLOCK + 2)
        )
        last = close[FRAMES_PER_BLOCK - 1].objects
        next_block = close[FRAMES_PER_BLOCK].objects
        assert len(np.intersect1d(last.ids, next_block.ids)) > 2
    with pytest.raises(FileExistsError, match="interval"):
        simulate_dataset(out=tmp_path / "close.hdf5", **small_job(frames=FRAMES_PER_BLOCK + 2))
    assert (
        "interval"
        not in simulation.Job(
            job["site"], job["sensors"], fleet_named("catalogue", None), 5, 0
        ).plan
    )
