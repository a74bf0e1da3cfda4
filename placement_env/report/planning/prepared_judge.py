"""Judges of sensor sets, each prepared on one part of a plan's traffic."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from placement_env.analysis.intervals import BLOCK_FRAMES, frames_for_width
from placement_env.fidelity.preparation import Preparation
from placement_env.objective import Objective
from placement_env.report.planning.judging import Judge, one_stage
from placement_env.report.planning.question import Question
from placement_env.report.planning.refusals import Refusal, refuse_traffic
from toolkit.arrays import Bool
from toolkit.runtime.run import Run

MAX_FINAL_FRAMES = 1200  # frames that a plan may use to reach a width


class PreparedJudge(NamedTuple):
    """Traffic at the first drawing of the site, and the judge over all drawings.

    A drawing fills in at random what no map knows of the site."""

    preparation: Preparation
    judge: Judge


def prepare_judge(
    question: Question, objectives: Sequence[Objective], run: Run, *, compares: bool = False
) -> PreparedJudge:
    """Simulate one part of the traffic at each drawing of the site, and return the judge on it.

    A drawing fills in at random what no map knows of the site; the first is the site itself.

    Args:
        question: The question.
        objectives: Objective of the searches for each drawing, which has the candidates.
        run: Seed and number of frames of this part.
        compares: True if many sets are compared, for which a detector may be coarser
            (`quick_detector`)."""
    preparations = [
        Preparation(drawing.judge_setting(objective.candidates), run, compares_sets=compares)
        for drawing, objective in zip(question.at_drawings, objectives, strict=True)
    ]
    judges = [
        Judge.from_preparation(preparation, question.run.seed) for preparation in preparations
    ]
    return PreparedJudge(preparations[0], replace(judges[0], drawings=tuple(judges[1:])))


def prepare_final_judge(
    question: Question, objectives: Sequence[Objective], is_member: Bool[np.ndarray, " candidates"]
) -> PreparedJudge:
    """Prepare the last part of the traffic, with enough frames for the requested width.

    Traffic is simulated again with more frames until the AP interval of the chosen set is as narrow
    as the question's width, or `MAX_FINAL_FRAMES` are reached. Without a requested width, or
    without a counted class, the first attempt comes back.

    is_member: True for the candidates of the chosen set; objectives: one for each drawing."""
    run = question.part("judgement")
    width = question.width
    while True:
        prepared = prepare_judge(question, objectives, run)
        judge = prepared.judge
        frames = prepared.preparation.frames
        if width is None or judge.absent_labels or frames >= MAX_FINAL_FRAMES:
            return prepared
        stage = one_stage(run, "frames of the chosen set", frames)
        judgements, _ = judge.judge_cases(is_member[None], stage)  # one row, for the only set
        judgement = judgements[0].counted
        interval_width = judgement.high - judgement.low
        if interval_width <= width:
            return prepared
        if math.isnan(interval_width):  # too few frames for an interval
            needed_frames = 2 * frames
        else:
            needed_frames = frames_for_width(frames, interval_width, width)
        min_frames = frames + frames // 4 + BLOCK_FRAMES  # so that few attempts are made
        run = replace(run, frames=min(MAX_FINAL_FRAMES, max(needed_frames, min_frames)))


def check_objects(question: Question, judge: Judge) -> None:
    """Raise `Refusal` if the traffic of a judge lacks a class that counts."""
    if judge.absent_labels:
        reasons = refuse_traffic(question, judge.absent_labels, judge.frames, "judging")
        raise Refusal(reasons, question.setting.pool)
