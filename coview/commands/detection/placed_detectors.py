"""Detectors at the places of recordings, for `coview detect` and `coview track`."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from coview.detector_spec import DetectorSpec
from coview.detectors import open_detector
from toolkit.calibration.place import Place
from toolkit.objects import Detector

if TYPE_CHECKING:
    from toolkit.datasets.recording_views import Part
    from toolkit.detection.detect import FrameDetections
    from toolkit.detection.standing import StandingScene
    from toolkit.frame import Recording


class PlacedDetector(NamedTuple):
    """Detector, and how its frames are put on level ground."""

    detector: Detector
    place: Place


class Detectors:
    """Detectors by what is known about a recording.

    spec: parsed name of the detector; place: area and ground as the options give them."""

    def __init__(self, spec: DetectorSpec, place: Place) -> None:
        """Open the detector, unless it must first know each recording, its site or background."""
        from toolkit.sites.site import PlaceMismatch

        self.spec = spec.in_bfloat16()
        self.place = place
        self.levelled = replace(place, level=place.level or "map")
        self.network: Detector | None = None
        # why the detector is for no place, but perhaps for a recording's site
        self.misfit: PlaceMismatch | None = None
        if not self.spec.knows_background():
            try:
                self.network = open_detector(self.spec, self.levelled)
            except PlaceMismatch as misfit:
                self.misfit = misfit

    def choose(
        self, recordings: "Sequence[Recording]", scenes: "Sequence[StandingScene | None]"
    ) -> list[PlacedDetector]:
        """Return the detector for each recording, with the place in which it detects.

        A detector that knows the empty site, or is for one site only, is opened for its recording.
        Other recordings share one network, and those with a learnt scene another one without
        background.

        scenes: standing scene of each recording, None if it is not learnt. Raises PlaceMismatch for
        a detector of one site in a recording of no known site."""
        network_for_scenes = self.network
        if any(scene is not None for scene in scenes):
            network_for_scenes = open_detector(self.spec.without_background(), self.levelled)
        placed_detectors = []
        for recording, scene in zip(recordings, scenes, strict=True):
            site = recording.site if self.place.uses_site(recording.site) else None
            if self.misfit is not None and site is None:
                raise self.misfit
            if self.network is None or self.spec.knows_background(site):
                detector = open_detector(self.spec, recording, self.place)
                placed_detectors.append(PlacedDetector(detector, self.place))
            elif scene is None or network_for_scenes is None:
                placed_detectors.append(PlacedDetector(self.network, self.levelled))
            else:
                placed_detectors.append(PlacedDetector(network_for_scenes, self.levelled))
        return placed_detectors


def detect_in_turn(
    jobs: "Sequence[tuple[Part, PlacedDetector, StandingScene | None]]",
    progress: Callable[[int], None],
) -> "Iterator[FrameDetections]":
    """Yield the detections of each frame, and warn once of a missing ground.

    jobs: frames of each recording, with detector and standing scene (None if it is not learnt);
    progress: function that is called with the number of frames done in all recordings."""
    from toolkit.detection.detect import detect_frames

    has_warned = False
    done = 0
    for frames, placed, scene in jobs:
        left_out_count = 0  # detections that belong to the standing scene
        for result in detect_frames(frames, placed.detector, placed.place, scene):
            if result.stand.warning is not None and not has_warned:
                has_warned = True
                warnings.warn(f"{result.frame.name}: {result.stand.warning}", stacklevel=2)
            done += 1
            left_out_count += result.left_out
            progress(done)
            yield result
        if scene is not None and left_out_count:
            warnings.warn(scene.describe(left_out_count), stacklevel=2)
