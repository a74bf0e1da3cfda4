"""`DetectionPool`: detection in the frames of a centre, next to the loop that gives them out.

Threads detect, so that nothing else waits for a detection. A frame that comes while all are
at work waits for the next one that is free, unless a newer frame takes its place. So detection
takes place as often as it can, always in the newest frame, and never falls behind."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from threading import Lock

from toolkit.calibration.place import Place
from toolkit.detection.detect import FrameDetections, detect_frame, detect_frames
from toolkit.detection.standing import StandingScene
from toolkit.frame import Frame
from toolkit.objects import Detector
from toolkit.sites.site import Site

DEADLINE_S = 0.08  # so that what is written is out within 0.12 s


@dataclass(frozen=True)
class Detection:
    """Detector of a centre, where and how often it works, and how long a frame waits for it.

    Attributes:
        detector: Detector.
        place: Area and ground.
        site: Known site, None without one.
        scene: Standing scene whose detections are left out, None to keep all.
        detect_every: 2 to detect in every second frame, and so on.
        parallel: Number of frames in which it detects at the same time.
        deadline_s: Longest wait for detections, from a frame's last point (s).
    """

    detector: Detector
    place: Place = field(default_factory=Place)
    site: Site | None = None
    scene: StandingScene | None = None
    detect_every: int = 1
    parallel: int = 1
    deadline_s: float = DEADLINE_S

    def detect(self, frames: Iterable[Frame]) -> Iterator[FrameDetections]:
        """Yield the detections in each frame, one after the other."""
        return detect_frames(_SiteFrames(frames, self.site), self.detector, self.place, self.scene)


class DetectionPool:
    """Threads that detect in frames, begun and taken in the order of time.

    Args:
        detection: Detector, place, and number of threads.
        wake: Called by a thread that is done.
        threads: Threads that detect; as many as `detection.parallel` if left out.

    Attributes:
        detection: As given.
    """

    def __init__(
        self,
        detection: Detection,
        wake: Callable[[], None] = lambda: None,
        threads: Executor | None = None,
    ) -> None:
        """Start without frames.

        wake: called by a thread that has detected; threads: those that detect, None for
        `detection.parallel` new ones."""
        self.detection = detection
        self._wake = wake
        self._threads = threads or ThreadPoolExecutor(detection.parallel)
        self._waiting: Frame | None = None  # next frame to detect in
        self._in_work: deque[_DetectionJob] = deque()
        self._ground_lock = Lock()  # held by the thread that finds the ground of a frame
        self._ground_frame: Frame | None = None
        self._stands = detection.place.stands(self._yield_frames(), detection.site)

    def add(self, frame: Frame) -> None:
        """Detect in a frame as soon as a thread is free, unless a newer frame comes before.

        frame: later than all frames before."""
        self._waiting = frame
        self._begin()

    def take(self, time_s: float) -> list[FrameDetections]:
        """Return the detections that are done, the oldest first, in frames up to a time (s).

        None comes before an older one. Raises the errors of the detector."""
        results = []
        while self._in_work and self._in_work[0].time_s <= time_s and self._in_work[0].is_done():
            results.append(self._in_work.popleft().future.result())
        self._begin()
        return results

    def is_expected(self, time_s: float) -> bool:
        """Return True if detections in frames up to a time (s) are still to come."""
        if self._in_work:
            return self._in_work[0].time_s <= time_s
        return self._waiting is not None and self._waiting.time <= time_s

    def close(self) -> None:
        """End the threads after the detections that they work on."""
        self._threads.shutdown(cancel_futures=True)

    def _begin(self) -> None:
        """Begin to detect in the frame that waits, if a thread is free."""
        running = sum(not job.is_done() for job in self._in_work)
        if self._waiting is None or running >= self.detection.parallel:
            return
        frame = self._waiting
        self._waiting = None
        future = self._threads.submit(self._detect, frame)
        self._in_work.append(_DetectionJob(frame.time, future))
        future.add_done_callback(lambda future: self._wake())

    def _detect(self, frame: Frame) -> FrameDetections:
        """Find the ground of a frame, and detect in it."""
        with self._ground_lock:
            self._ground_frame = frame
            # the iterator of grounds draws the frame just set; it gives it with its ground and area
            levelled_frame = next(self._stands)
        return detect_frame(*levelled_frame, self.detection.detector, self.detection.scene)

    def _yield_frames(self) -> Iterator[Frame]:
        """Yield the frame of each `_detect`."""
        while self._ground_frame is not None:
            yield self._ground_frame


@dataclass(frozen=True, eq=False)
class _DetectionJob:
    """Frame that a thread detects in.

    Attributes:
        time_s: Time of the frame (s).
        future: Its detections.
    """

    time_s: float
    future: "Future[FrameDetections]"

    def is_done(self) -> bool:
        """Return True if the detections, or an error, are there."""
        return self.future.done()


class _SiteFrames:
    """Frames of a site, as `detect_frames` takes them.

    site: known site, None without one."""

    def __init__(self, frames: Iterable[Frame], site: Site | None) -> None:
        self.site = site
        self._frames = frames

    def __iter__(self) -> Iterator[Frame]:
        return iter(self._frames)
