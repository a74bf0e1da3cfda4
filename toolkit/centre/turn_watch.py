"""`TurnWatch`: sensors that were turned on their mounts, found by registration.

A sensor that sees far beyond its empty scene shows it in a few messages (`SensorMonitor`). One that
is turned by a degree or two may not: ground looks alike from there. So the sensors take turns: the
surfaces that the last images of one have in common are registered to its empty scene, in another
process, which takes longer than a frame may. A sensor is turned if the pose found is clearly off
its believed one, twice in a row; checks in which no pose is found do not count."""

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import lru_cache
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Protocol

import numpy as np

from toolkit.arrays import ImageRanges, Pose
from toolkit.calibration.empty_scene import EmptyScene, SceneLearner
from toolkit.calibration.poses import find_pose
from toolkit.calibration.reference_surface import Surface, cloud_surface, scene_points
from toolkit.geometry import transform
from toolkit.sensors.sensor import Sensor

MIN_TURN_RAD = float(np.deg2rad(0.7))
MIN_TURNED_CHECKS = 2  # in a row
MAX_ROUND_S = 14.0  # in which every sensor is checked once; one that seems turned is soon again
IMAGE_EVERY_S = 0.5  # between two images that are kept
KEPT_IMAGES = 8
_NICENESS = 10  # lower priority, so that detection comes first
_TurnJob = tuple[EmptyScene, Pose, Sequence[ImageRanges]]  # arguments of `find_turn`


def find_turn(
    scene: EmptyScene, world_SE3_sensor: Pose, images: Sequence[ImageRanges]
) -> float | None:
    """Return the angle (rad) by which a sensor is turned, 0 if it is not clearly turned.

    scene: its empty scene; world_SE3_sensor: its believed pose; images: its last images, at least
    2. None if its pose cannot be found."""
    sensor = Sensor(scene.name, scene.model, world_SE3_sensor)
    learner = SceneLearner(sensor, len(images))
    for image in images:
        learner.add(image)
    points, deviation = scene_points(learner.scene())
    try:
        surface = _make_surface(_SceneKey(scene, world_SE3_sensor))
    except ValueError:
        return None
    found = find_pose(points, sensor, surface, deviation=deviation)
    if found.registration is None:
        return None
    return found.turn if found.has_drifted else 0.0


class _SceneKey:
    """Empty scene and pose, equal to any other of the same contents.

    scene: empty scene; world_SE3_sensor: pose of its sensor."""

    def __init__(self, scene: EmptyScene, world_SE3_sensor: Pose) -> None:
        self.scene = scene
        self.world_SE3_sensor = world_SE3_sensor
        self._key = (scene.digest, world_SE3_sensor.tobytes())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _SceneKey) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)


@lru_cache(maxsize=64)
def _make_surface(key: _SceneKey) -> Surface:
    """Return the surface of an empty scene, world frame. Raises ValueError if it has too little."""
    points, _ = scene_points(key.scene)
    return cloud_surface(transform(key.world_SE3_sensor, points))


class TurnFinder(Protocol):
    """Worker that finds turns (`find_turn`) while others go on."""

    def submit(
        self, scene: EmptyScene, world_SE3_sensor: Pose, images: Sequence[ImageRanges]
    ) -> "Future[float | None]":
        """Begin to find the turn of a sensor."""


class TurnWatch:
    """Watch over the poses of all sensors with an empty scene.

    Args:
        sensors: Sensors by name, at their believed poses.
        scenes: Empty scenes by sensor.
        finder: Finds turns, one at a time.

    Attributes:
        turned: Names of the sensors that are turned.
    """

    def __init__(
        self, sensors: Mapping[str, Sensor], scenes: Mapping[str, EmptyScene], finder: TurnFinder
    ) -> None:
        """Begin without images.

        scenes: empty scenes of the sensors to watch, by name; finder: registers the images of a
        sensor."""
        self.turned: set[str] = set()
        self._poses = {name: sensors[name].pose for name in scenes}
        self._scenes = dict(scenes)
        self._finder = finder
        self._images: dict[str, deque[ImageRanges]] = {
            name: deque(maxlen=KEPT_IMAGES) for name in scenes
        }
        self._image_times_s = dict.fromkeys(scenes, -np.inf)
        self._turned_checks = dict.fromkeys(scenes, 0)  # in a row
        self._unconfirmed: set[str] = set()  # names: seemed turned in the last check, not yet sure
        self._waiting = deque(scenes)  # names of the sensors, the next to be checked first
        self._job: Future[float | None] | None = None
        self._job_name = ""
        self._next_job_s = -np.inf
        self._job_every_s = MAX_ROUND_S / max(len(scenes), 1)

    def look(self, name: str, image: ImageRanges, time_s: float) -> bool:
        """Return True if a sensor is turned.

        image: its newest image; time_s: time of the measurement (s)."""
        if name not in self._scenes:
            return False
        if time_s >= self._image_times_s[name] + IMAGE_EVERY_S:
            self._image_times_s[name] = time_s
            self._images[name].append(image)
        self._finish_job()
        self._start_job(time_s)
        return name in self.turned

    def _finish_job(self) -> None:
        """Take the result of a registration that is done: whether its sensor is turned.

        A registration that failed says nothing of its sensor, so nothing found before is lost."""
        if self._job is None or not self._job.done():
            return
        name = self._job_name
        turn = self._job.result()
        self._job = None
        self._unconfirmed.discard(name)
        if turn is None:
            return
        is_turned = turn >= MIN_TURN_RAD
        self._turned_checks[name] = self._turned_checks[name] + 1 if is_turned else 0
        if self._turned_checks[name] >= MIN_TURNED_CHECKS:
            self.turned.add(name)
        elif is_turned:
            self._unconfirmed.add(name)
        else:
            self.turned.discard(name)

    def _start_job(self, time_s: float) -> None:
        """Register the sensor whose turn it is, if no job is running and one is due.

        Sensors that seemed turned in their last check go first, as soon as they have enough new
        images."""
        if self._job is not None or time_s < self._next_job_s:
            return
        ready = [name for name in self._waiting if len(self._images[name]) == KEPT_IMAGES]
        if not ready:
            return
        name = next((name for name in ready if name in self._unconfirmed), ready[0])
        self._waiting.remove(name)
        self._waiting.append(name)
        images = list(self._images[name])
        self._images[name].clear()
        self._next_job_s = time_s + self._job_every_s
        self._job_name = name
        self._job = self._finder.submit(self._scenes[name], self._poses[name], images)


class TurnProcess:
    """Process that registers sensors, gives way to others and ends with this one.

    It starts with the first job. A thread talks to it, so that no job holds up the caller."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1)
        self._process: BaseProcess | None = None
        self._connection: Connection | None = None

    def submit(
        self, scene: EmptyScene, world_SE3_sensor: Pose, images: Sequence[ImageRanges]
    ) -> "Future[float | None]":
        """Begin `find_turn`; its result is None if the process dies."""
        return self._thread.submit(self._ask, (scene, world_SE3_sensor, images))

    def close(self) -> None:
        """End the process."""
        if self._process is not None:
            self._process.terminate()
        self._thread.shutdown(cancel_futures=True)

    def _ask(self, job: _TurnJob) -> float | None:
        """Send a job to the process and return its result; None if the process dies.

        A process that died is started again at the next job."""
        try:
            if self._connection is None:
                self._start()
            assert self._connection is not None
            self._connection.send(job)
            result: float | None = self._connection.recv()
        except (EOFError, OSError):
            self._connection = None
            return None
        return result

    def _start(self) -> None:
        """Start the process."""
        context = multiprocessing.get_context("spawn")  # forking would copy locks of threads
        self._connection, other_end = context.Pipe()
        self._process = context.Process(target=_answer_jobs, args=(other_end,), daemon=True)
        self._process.start()
        other_end.close()  # the process has the other end, and its death shows here


def _answer_jobs(connection: Connection) -> None:
    """Answer jobs until the other end of the connection is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business
    if hasattr(os, "nice"):
        os.nice(_NICENESS)
    with suppress(EOFError, OSError):
        while True:
            connection.send(find_turn(*connection.recv()))
