"""`coview detect`: find road users in recordings in any layout."""

import warnings
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from coview.arguments import check_ending, check_least
from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector, open_detector
from coview.outputs import OK, Writing, check_file, check_new_folder, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening
from toolkit.detection.place import Place
from toolkit.objects import Detector


def detect(
    clouds: Positional[tuple[Path, ...]],
    /,
    *,
    out: Path,
    detector: str = "general",
    frames: int | None = None,
    format: Literal["boxes", "openlabel", "kitti"] = "boxes",
    opening: Opening = Opening(),
    place: Place = Place(),
    writing: Writing = Writing(),
) -> int:
    """Find road users in clouds, bags, public sets and simulated recordings, on level ground.

    Example: coview detect my-recording --level map --out boxes.json

    Example: coview detect junction.bag --layout rosbag --still --area -40 -40 40 40
        --out boxes.json

    Args:
        clouds: Cloud files, folders, bags or recordings.
        out: File of boxes, or folder of OpenLABEL or KITTI files, one per frame.
        detector: general, another shipped network, a file of weights or in ONNX, or
            package.module:callable; +background, which plan.json names too, drops what stands at
            the recording's site or in its empty scene; general has it where the site is known, or
            learns it where the sensors stand still over ten frames and more; general-background has
            not; +phases4 detects on four shifted grids; +float32 in exact numbers where the
            processor has quicker ones.
        frames: Number of first frames of each recording; all when left out.
        format: One JSON file (boxes), openlabel or kitti."""
    from toolkit.datasets.recordings import Part
    from toolkit.detection.detect import (
        Detected,
        describe_summary,
        detect_frames,
        summarise,
        write_detections,
    )
    from toolkit.detection.standing import learn_standing_scene

    check_least("--frames", frames, 1, "leave it out for all")
    if not clouds:
        raise ValueError("give clouds to detect in: files, folders or bags")
    spec = DetectorSpec.from_name(detector)
    check_detector(spec)
    levelled = replace(place, level=place.level or "map")
    quick = spec.in_bfloat16()
    network = None if quick.knows_background() else open_detector(quick, levelled)
    if format == "boxes":
        check_ending(out, (".json",), "a file of boxes")
    check = check_file if format == "boxes" else check_new_folder
    check(out, inputs=[*clouds, *opening.files], overwrite=writing.overwrite)
    with ExitStack() as stack:
        recordings = [stack.enter_context(opening.open(path)) for path in clouds]
        opened = [Part(recording, frames) for recording in recordings]
        scenes = []
        for recording, part in zip(recordings, opened, strict=True):
            learns_scene = recording.site is None and spec.learns_scene
            scenes.append(learn_standing_scene(part) if learns_scene else None)
        at_scene = network
        if any(scene is not None for scene in scenes):
            at_scene = open_detector(quick.without_background(), levelled)
        detectors: list[tuple[Detector, Place]] = []
        for recording, scene in zip(recordings, scenes, strict=True):
            site = recording.site if place.at(recording.site) else None
            if network is None or quick.knows_background(site):
                detectors.append((open_detector(quick, recording, place), place))
            elif scene is None or at_scene is None:
                detectors.append((network, levelled))
            else:
                detectors.append((at_scene, levelled))
        level = detectors[0][1].level or "none"
        bar = stack.enter_context(progress_bar("cloud", sum(map(len, opened)), hidden=writing.json))

        def watch() -> Iterator[Detected]:
            """Yield the detections of each frame, and warn once of a missing ground."""
            warned = False
            done = 0
            for part, placed, scene in zip(opened, detectors, scenes, strict=True):
                left_out = 0
                for detected in detect_frames(part, *placed, scene):
                    if detected.stand.warning is not None and not warned:
                        warned = True
                        warnings.warn(
                            f"{detected.frame.name}: {detected.stand.warning}", stacklevel=2
                        )
                    done = done + 1
                    left_out = left_out + detected.left_out
                    bar.to(done)
                    yield detected
                if scene is not None and left_out:
                    warnings.warn(scene.describe(left_out), stacklevel=2)

        figures = summarise(write_detections(watch(), out, format, detector=detector, level=level))
    print_result(
        figures | {"out": str(out)}, f"{out}: {describe_summary(figures)}", as_json=writing.json
    )
    return OK
