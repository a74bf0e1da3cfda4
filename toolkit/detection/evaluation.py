"""Score fusion schemes and sensor sets on a recording: the first table of the paper, and more.

What a sensor sees and detects is computed once per frame and shared by all schemes and sets
(`toolkit.detection.view`). Only the fused boxes of a frame are kept. Three protocols define the
objects to find:

- `exact`: objects whose centre is in the site's area. Objects outside it are ignored, neither
  misses nor false alarms (`counted` of `toolkit.detection.metrics.evaluate`).
- `published`: the same, but objects outside the area are removed, and detections are matched as in
  the published code.
- `measured`, the rule for recorded labels: objects in the area, in the region with complete labels,
  with at least one point. An object labelled twice counts once. Detections outside the region with
  complete labels do not count.

Each class is scored separately: a cyclist reported as a pedestrian is a false alarm for pedestrians
and a miss for cyclists. Detections are scored as the detector reports them, above its score
threshold; `ClassFigures` holds precision and recall at that threshold. With a breakdown, AP is also
given by range, by points, and as KITTI and nuScenes count it (`toolkit.detection.breakdown`).
Milliseconds are the median over frames, from measurements to fused boxes, with sensors working in
parallel as in the paper."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

from toolkit.calibration.place import Place
from toolkit.calibration.recording_scenes import Scenes
from toolkit.datasets.listing import check_labels
from toolkit.datasets.recording_views import Part, ReadRecording, Reads
from toolkit.detection.breakdown import GroupRow
from toolkit.detection.comparison import Comparison, list_ious, name_schemes, name_sets
from toolkit.detection.evaluation_result import Evaluation
from toolkit.detection.evaluation_tables import sensor_text
from toolkit.detection.figures import ClassFigures, Row
from toolkit.detection.frame_scores import FrameResult, ScoringJob
from toolkit.detection.link.load import SetLoad
from toolkit.detection.metrics import TRUE_IOU
from toolkit.detection.provenance import dataset_origin, detector_origin, settings_origin
from toolkit.detection.scheme import Chained
from toolkit.detection.set_results import SetResults
from toolkit.frame import Frame, Recording
from toolkit.objects import Detector, check_known, label_index
from toolkit.runtime.run import Processes

BATCH_FRAMES = 10  # frames that a worker scores in one go


def evaluate_recording(
    recording: Recording,
    detector: Detector,
    comparison: Comparison = Comparison(),
    *,
    place: Place = Place(),
    reads: Reads = Reads(),
    scenes: Scenes | None = None,
    run: Processes = Processes(),
) -> Evaluation:
    """Score every scheme with every sensor set, class by class, at each of its IoU thresholds.

    comparison: schemes, sensor sets, classes and thresholds; place: detection area and ground;
    reads: errors of the sensors and number of frames; scenes: empty scenes for schemes that need
    them, learnt from this recording if None; run: processes and progress. Several workers share the
    frames, unless a scheme can only read its messages in order.

    Raises ValueError for an unknown scheme, sensor, class or error profile, a class that the
    detector does not know, two schemes of one name, and a recording without frames."""
    frame_total = reads.count(recording)
    errors = reads.profile()
    ious = list_ious(comparison)
    check_known(detector, list(ious))
    site = recording.site
    if site is not None and comparison.radius is not None:
        site = replace(site, hybrid_radius=comparison.radius)
    schemes = name_schemes(comparison.schemes)
    check_labels(recording, frame_total)
    measured = ReadRecording(recording, reads)
    at_site = place.uses_site(site)  # True if detection uses the site's ground and area
    first_frame = measured[0]
    if scenes is None:
        scenes = Scenes(measured if at_site else Part(measured, frame_total))
    job = ScoringJob(
        recording=measured,
        detector=detector,
        comparison=comparison,
        place=place,
        site=site,
        at_site=at_site,
        schemes=schemes,
        sets=name_sets(first_frame, comparison.sensor_sets),
        scenes=scenes,
        protocol=comparison.protocol or ("exact" if at_site else "measured"),
        count_points=(not at_site) if comparison.breakdown is None else comparison.breakdown,
    )
    results = _score_frames(job, first_frame, frame_total, run)
    settings = job.describe(
        ious, frames=frame_total, noise_seed=reads.noise_seed, errors=errors.origin
    )
    origin = settings_origin(comparison.codec, **settings)
    provenance = dataset_origin(recording) | detector_origin(detector) | origin
    return _pool_results(job, results, ious, provenance)


def _pool_results(
    job: ScoringJob,
    results: Sequence[FrameResult],
    ious: Mapping[str, tuple[float, ...]],
    provenance: dict[str, Any],
) -> Evaluation:
    """Pool the results of all frames into figures of each scheme, sensor set and class.

    ious: IoU thresholds of each class, by its name; provenance: data, detector and settings, stored
    with the figures."""
    rows = list[Row]()
    classes = list[ClassFigures]()
    loads = list[SetLoad]()
    groups = list[GroupRow]()
    summaries: dict[str, dict[str, Any]] = {}
    for scheme_name, sensors in results[0].fused:  # the same for all frames
        set_results = SetResults(job, results, scheme=scheme_name, sensors=sensors)
        for label, thresholds in ious.items():
            scores = set_results.score_class(label, thresholds)
            rows += [set_results.make_row(label, iou, scores[iou]) for iou in thresholds]
            true_score = scores[TRUE_IOU[label_index(label)]]
            classes.append(set_results.rate_threshold(label, true_score))
        title = scheme_name
        if len(job.sets) > 1:
            title = f"{scheme_name} {sensor_text(sensors)}"
        if job.count_points:
            groups += set_results.break_down(title, ious)
        load = set_results.find_load()
        if load is not None:
            loads.append(SetLoad(scheme_name, sensors, load))
        summaries[title] = set_results.summarise(load)
    return Evaluation(
        tuple(rows),
        provenance,
        classes=tuple(classes),
        loads=tuple(loads),
        schemes=summaries,
        breakdown=tuple(groups),
    )


def _score_frames(
    job: ScoringJob, first_frame: Frame, frame_total: int, run: Processes
) -> list[FrameResult]:
    """Return the results of all frames, in order, scored by the processes of `run`.

    job: scores frames; first_frame: frame 0, read already; frame_total: number of frames. All
    frames are scored in this process if `run` has no other, or if a scheme needs earlier messages
    (`Chained`), as these are kept from frame to frame. Warns in that case of ground that is not
    level in frame 0."""
    # called with the number of frames done, None for nothing
    progress = run.stage("frame", frame_total)
    results = list[FrameResult]()
    if run.has_one_process or any(isinstance(scheme, Chained) for scheme in job.schemes.values()):
        frames = chain([first_frame], (job.recording[k] for k in range(1, frame_total)))
        for result in job.score(frames, range(frame_total)):
            results.append(result)
            if progress is not None:
                progress(len(results))
        if results[0].warning is not None:
            warnings.warn(f"frame 0: {results[0].warning}", stacklevel=3)
        return results
    starts = range(0, frame_total, BATCH_FRAMES)
    batches = [range(start, min(start + BATCH_FRAMES, frame_total)) for start in starts]
    # progress counts frames, but the processes report the number of batches done
    report = (
        None if progress is None else lambda done: progress(min(frame_total, BATCH_FRAMES * done))
    )
    results += chain.from_iterable(run.map(job, batches, progress=report))
    return results
