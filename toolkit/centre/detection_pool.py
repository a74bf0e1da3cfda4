"""`DetectionPool`: detection in the frames of a centre, in several of them at the same time.

One detection does not use all of several cores: parts of it run on one. If detections of successive
frames run side by side, each in a thread and on its share of the cores, more frames are detected,
but each takes longer."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field

from toolkit.calibration.place import Place
from toolkit.detection.detect import FrameDetections, detect_frame, detect_frames
from toolkit.detection.standing import StandingScene
from toolkit.frame import Frame
from toolkit.objects import Detector
from toolkit.sites.site import Site


@dataclass(frozen=True)
class Detection:
    """Detector of a centre, and where and how often it works.

    Attributes:
        detector: Detector.
        place: Area and ground.
        site: Known site, None without one.
        scene: Standing scene whose detections are left out, None to keep all.
        detect_every: 2 to detect in every second frame, and so on; None for as often as it can.
        parallel: Number of frames in which it detects at the same time.
    """

    detector: Detector
    place: Place = field(default_factory=Place)
    site: Site | None = None
    scene: StandingScene | None = None
    detect_every: int | None = None
    parallel: int = 1

    def detect(self, frames: Iterable[Frame]) -> Iterator[FrameDetections]:
        """Yield the detections in each frame, one after the other."""
        return detect_frames(_SiteFrames(frames, self.site), self.detector, self.place, self.scene)


class DetectionPool:
    """Threads that detect.

    Args:
        detection: Detector, place, and number of threads. With one, the calling thread detects.
        wake: Called by a thread that is done.
    """

    def __init__(self, detection: Detection, wake: Callable[[], None]) -> None:
        """Start the threads, none if the calling thread is to detect.

        wake: called by a thread that has detected."""
        self._detection = detection
        self._wake = wake
        self._next_frame: Frame | None = None
        self._stands = detection.place.stands(self._yield_frames(), detection.site)
        self._threads: ThreadPoolExecutor | None = None
        if detection.parallel > 1:
            self._threads = ThreadPoolExecutor(detection.parallel)

    def submit(self, frame: Frame) -> "Future[FrameDetections]":
        """Find the ground of a frame, then begin to detect in it; without threads, detect now.

        Returns the detections, which may still have to come."""
        self._next_frame = frame
        # the iterator of grounds draws the frame just set; it gives it with its ground and area
        levelled_frame = next(self._stands)
        arguments = (*levelled_frame, self._detection.detector, self._detection.scene)
        if self._threads is not None:
            future = self._threads.submit(detect_frame, *arguments)
            future.add_done_callback(lambda future: self._wake())
            return future
        finished_future: Future[FrameDetections] = Future()
        finished_future.set_result(detect_frame(*arguments))
        return finished_future

    def close(self) -> None:
        """End the threads after the detections that they work on."""
        if self._threads is not None:
            self._threads.shutdown(cancel_futures=True)

    def _yield_frames(self) -> Iterator[Frame]:
        """Yield the frame of each `submit`."""
        while self._next_frame is not None:
            yield self._next_frame


class _SiteFrames:
    """Frames of a site, as `detect_frames` takes them.

    site: known site, None without one."""

    def __init__(self, frames: Iterable[Frame], site: Site | None) -> None:
        self.site = site
        self._frames = frames

    def __iter__(self) -> Iterator[Frame]:
        return iter(self._frames)
