"""The chosen set judged in several draws of the sensors' errors."""

from collections.abc import Sequence

import numpy as np

from placement_env.fidelity.detector import Detected
from placement_env.fidelity.renders import Renders
from placement_env.report import content
from placement_env.report.planning import judging
from toolkit.runtime.run import Run
from toolkit.sensors.error_profiles import only_own_noise

ERROR_DRAW_COUNT = 10  # draws of errors in which the chosen set is judged
MAX_DRAW_FRAMES = 60  # frames of each draw of errors


def by_draw(
    judge: judging.Judge, members: tuple[int, ...], run: Run = Run()
) -> tuple[content.DrawnErrors, ...]:
    """Judge a set at each error profile in several draws of the sensors' errors.

    Each draw is as one mounting: its errors are the same in all frames. Each row holds the AP of
    all draws, their mean and their 10 % quantile. A profile has no row if it has only the noise of
    the sensors' models, or if its measurements cannot be drawn again (other than `Renders`).

    judge: judge, whose first `MAX_DRAW_FRAMES` frames are used; members: indices of the set's
    candidates; run: reports the draws."""
    frames = min(judge.frames, MAX_DRAW_FRAMES)
    rows = []
    for detected in judge.profiles:
        renders = detected.renders
        if not isinstance(renders, Renders) or only_own_noise(renders.errors):
            continue
        report = run.stage(f"draws of the errors {renders.errors.name}", ERROR_DRAW_COUNT)
        aps: list[float] = []
        for seed in range(1, ERROR_DRAW_COUNT + 1):
            aps.append(judge_draw(judge, detected, renders, members, seed))
            if report is not None:
                report(seed)
        row = content.DrawnErrors(
            profile=renders.errors.name,
            aps=tuple(aps),
            mean=float(np.mean(aps)),
            tenth=float(np.quantile(aps, 0.1)),
            frames=frames,
        )
        rows.append(row)
    return tuple(rows)


def judge_draw(
    judge: judging.Judge, detected: Detected, renders: Renders, members: Sequence[int], seed: int
) -> float:
    """Return the AP of a set in one draw of the errors, as a mean over IoU thresholds.

    Args:
        judge: Gives the number of frames and the IoU thresholds.
        detected: Detector at one error profile.
        renders: Its measurements, whose errors are drawn again.
        members: Indices of the set's candidates; in the new draw they are candidates 0, 1, ...
        seed: Seed of the draw."""
    drawn_renders = renders.draw_once(seed, members, min(judge.frames, MAX_DRAW_FRAMES))
    options = {name: getattr(detected, name) for name in ("codec", "memo", "processes", "classes")}
    ious = judge.cases.ious
    redrawn = Detected(drawn_renders, detected.detector, detected.scheme, **options)
    # one set: all candidates of the new draw, which are the members only
    figures = redrawn.at(ious[0], ious).estimates(np.ones((1, len(members)), np.bool_))
    return float(np.mean([figures[iou].ap[0] for iou in ious]))
