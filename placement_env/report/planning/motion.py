"""Figures of the chosen set on continuous traffic, the last stage of a plan."""

from dataclasses import replace

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.detector import Detected, detect_in_frames
from placement_env.fidelity.renders import Renders
from placement_env.fidelity.traffic import Traffic, simulate_continuous_traffic
from placement_env.report.motion_content import MotionFigures
from placement_env.report.planning.motion_scores import MovingStreet, count_groups, follow_classes
from placement_env.report.planning.question import PART_FRAMES, Question
from toolkit.objects import Detector, known_labels
from toolkit.runtime.run import Run
from toolkit.traffic.ways import NoPassage

MOTION_FRAMES = 300  # unless the question gives the number of frames of each part
MIN_MOTION_FRAMES = 20  # in fewer, hardly anybody comes in
MOTION_INTERVAL_S = 0.1


def measure_motion(
    question: Question, candidates: Candidates, members: tuple[int, ...], detector: Detector
) -> MotionFigures:
    """Follow and count road users with the chosen set, on traffic that no search saw.

    `coview simulate --every 0.1` makes the same traffic with this seed. The sensors are mounted
    once, with the errors of the first profile. Detections stay in the run's cache.

    Args:
        question: The question, whose run gives seed and number of frames.
        candidates: Candidates of the searches.
        members: Indices of the chosen candidates, ascending.
        detector: Detector of the plan's figures."""
    frames = question.run.frames_or(MOTION_FRAMES)
    run = question.run.part(len(PART_FRAMES), frames)
    figures = MotionFigures(
        refusal="",
        seed=run.seed,
        frames=frames,
        interval_s=MOTION_INTERVAL_S,
        traffic_sha256="",
        errors=question.cases.profiles[0].name,
    )
    if frames < MIN_MOTION_FRAMES:
        sentence = (
            f"Road users are not followed: {frames} frames at {1 / MOTION_INTERVAL_S:g} Hz are too "
            f"short, {MIN_MOTION_FRAMES} --frames or more are needed."
        )
        return replace(figures, refusal=sentence, frames=0)
    try:
        traffic = simulate_continuous_traffic(question.site, frames, run.seed)
    except NoPassage as error:
        return replace(figures, refusal=f"Road users are not followed: {error}.", frames=0)
    set_candidates = candidates.select(np.array(members))
    street = _detect_street(
        question, candidates=set_candidates, detector=detector, traffic=traffic, run=run
    )
    labels = known_labels(detector) or question.setting.counted.names
    street_errors = count_groups(street, labels, run.seed)
    return replace(
        figures,
        traffic_sha256=traffic.digest(),
        classes=follow_classes(street, labels, run.seed),
        counts=street_errors.groups,
        movements=street_errors.movements,
    )


def _detect_street(
    question: Question, candidates: Candidates, detector: Detector, traffic: Traffic, run: Run
) -> MovingStreet:
    """Detect in all frames of continuous traffic with all of some candidates together.

    run: processes, cache and the seed of noise and errors."""
    setting = question.setting
    renders = Renders(
        traffic,
        candidates,
        run.memo,
        noise_seed=run.seed,
        errors=question.cases.profiles[0],
        redrawn=False,  # the same errors in all frames
    )
    detected = Detected(
        renders,
        detector,
        setting.fusion,
        codec=setting.codec,
        memo=run.memo,
        processes=run,
        classes=setting.counted,
    )
    members = tuple(range(len(candidates)))
    frames = range(len(traffic))
    progress = run.stage("frames followed", len(frames))
    return MovingStreet(
        site=traffic.site,
        times=[snapshot.time for snapshot in traffic.snapshots],
        detections=detect_in_frames(detected, members, frames, progress),
        truths=[snapshot.objects for snapshot in traffic.snapshots],
    )
