"""`LiveScorer`: figures of variants, for one question after another in the same traffic."""

import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np

from placement_env.candidates.candidates import Candidates
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.seeing import see
from placement_env.fidelity.traffic import FRAMES
from placement_env.fidelity.visibility import Visibility
from placement_env.live.figures import LiveAnswer, Meter
from placement_env.live.suggestions import Suggester
from placement_env.live.variant import Variant, Yard
from placement_env.live.views import AllFrames, SensorViews, hold_back
from placement_env.objective import Score
from placement_env.setting import Rendering, Setting
from toolkit.runtime.run import Run

MAX_ANSWERS = 128  # figures of variants in memory


class LiveScorer:
    """Figures of variants by the surrogate, for a question that may change.

    A copy has the same views and figures, and goes on without the original. first_frames: number of
    frames that figures come from until `fetch` has made the views of all, None for all from the
    start; currency: currency of prices, "" for ordinary poles; max_sensors: greatest number of
    sensors without a problem, inf for any.

    Attributes:
        first: Setting at the start, as it was given.
        asked: Present setting, as it was asked.
        setting: Present setting with the yard's stock as candidates, scored by the surrogate.
        preparation: Traffic of the present setting.
        views: Views of sensors in that traffic.
        all_frames: All frames of traffic, while figures of the first few are shown.
    """

    preparation: Preparation
    views: SensorViews

    def __init__(
        self,
        yard: Yard,
        setting: Setting,
        run: Run,
        *,
        first_frames: int | None,
        currency: str,
        max_sensors: float,
    ) -> None:
        """Prepare to score by a setting, at first on the first frames of its traffic only.

        first_frames: number of frames that the first figures come from, None for all; max_sensors:
        largest number of sensors, infinite without a limit."""
        self._yard = yard
        self._currency = currency
        self._max_sensors = max_sensors
        self._earlier_answer: LiveAnswer | None = None  # the next answers state the change since it
        self.first_setting = setting
        # figures come from the first frames only, until the views of all are made
        begins_with_fewer = first_frames is not None and first_frames < run.frames_or(FRAMES)
        first_run = replace(run, frames=first_frames, cache=None) if begins_with_fewer else run
        self._start_question(setting, first_run)
        full_preparation = replace(self.preparation, run=run) if begins_with_fewer else None
        self.all_frames = AllFrames(full_preparation)

    def __getstate__(self) -> dict[str, Any]:
        state = dict(self.__dict__)
        for name in ("views", "all_frames", "_answers"):  # these change; all else is shared
            state[name] = copy(state[name])
        return state

    def _start_question(
        self, question: Setting, run: Run, before: Preparation | None = None
    ) -> None:
        """Prepare to score by a setting, and forget the figures by the setting before.

        question: setting asked for; the surrogate scores by it, at the yard's poses; before:
        preparation whose traffic is used again, None to make traffic by `run`. Views of sensors are
        kept if its panoramas are. Raises ValueError for several IoU thresholds."""
        if len(question.cases.ious) > 1:
            raise ValueError(f"live figures are of one IoU, got {question.cases.iou}: give one")
        setting = replace(question, candidates=self._yard.stock).with_fidelity("surrogate")
        preparation = Preparation(setting, run)
        preparation.check()
        panoramas_before = None if before is None else self.preparation.live
        self.asked_setting = question
        self.setting = setting
        self.preparation = preparation.intact_preparation
        if before is not None:
            self.preparation = self.preparation.share_traffic(before)
        self._meter = Meter(self.preparation, self._currency)
        self._answers = dict[Variant, LiveAnswer]()
        if panoramas_before is None or panoramas_before is not self.preparation.live:
            self.views = SensorViews(self._yard, self._meter)

    def ask(self, changes: dict[str, Any]) -> None:
        """Score by another setting in the same traffic.

        changes: new values of `Setting` fields by name, such as classes, cases, scheme and
        most_price. The next answer states no change."""
        before = self.preparation
        self._start_question(replace(self.asked_setting, **changes), before.run, before)
        self._earlier_answer = None

    @property
    def question(self) -> dict[str, object]:
        """Changes of the setting since the start: what is asked for now, as JSON values by name.

        Names are classes, iou, errors, scheme and most_price (None for any price)."""
        first_values = _describe_question(self.first_setting)
        present_values = _describe_question(self.asked_setting)
        return {
            name: value for name, value in present_values.items() if value != first_values[name]
        }

    @property
    def unseen(self) -> Visibility:
        """View without a sensor: the road users that count, in all frames."""
        return self._meter.unseen

    def answer(self, variant: Variant, what: str) -> LiveAnswer:
        """Figures of a variant, and their change since those given to `compare_with`.

        what: words for the change that led to the variant, "" without one."""
        return self.estimate(variant).since(self._earlier_answer, what)

    def compare_with(self, before: LiveAnswer | None) -> None:
        """Let the next answers state the change since these figures; None for no change."""
        self._earlier_answer = before

    def recall(self, variant: Variant) -> LiveAnswer | None:
        """Figures of a variant that are in memory, else None."""
        return self._answers.get(variant)

    def estimate(self, variant: Variant) -> LiveAnswer:
        """Figures of any variant, without a change; coarse ones in memory are made again."""
        answer = self._answers.get(variant)
        if answer is not None and not answer.coarse:
            return answer
        return self._estimate(variant)

    def _estimate(self, variant: Variant) -> LiveAnswer:
        """Figures of a variant from its views, which are then kept in memory."""
        view = self.views.see(variant)
        answer = self._meter.measure(view.candidates, view.seen, view.is_working)
        answer = replace(
            answer,
            coarse=view.coarse or self.all_frames.are_awaited,
            problems=answer.problems + self._list_problems(variant),
        )
        if len(self._answers) >= MAX_ANSWERS:
            self._answers.clear()
        self._answers[variant] = answer
        return answer

    def _list_problems(self, variant: Variant) -> tuple[str, ...]:
        """Problems that no figure shows: sensors in keep-out areas, and too many sensors."""
        kept_out_names = self._yard.list_kept_out(variant)
        problems = [f"{name} hangs in a keep-out area" for name in kept_out_names]
        if len(variant.sensors) > self._max_sensors:
            problems.append(
                f"it has {len(variant.sensors)} sensors, more than the {self._max_sensors} of "
                "its plan"
            )
        return tuple(problems)

    def is_coarse(self, variant: Variant) -> bool:
        """True if figures are of the first frames only, or a view is interpolated."""
        return self.all_frames.are_awaited or self.views.see(variant).coarse

    def score(self, variant: Variant) -> Score:
        """Score of the working sensors by the objective, on the same frames as live figures.

        Views are from panoramas at the sensors' exact heights, or from rays if the setting's
        rendering is "full"."""
        candidates = self._yard.candidates(variant.working_variant)
        rendering: Rendering = self.setting.rendering
        if rendering == "auto":
            rendering = "panorama"
        seen = see(
            self.preparation.traffic,
            candidates,
            labels=self.setting.counted.labels,
            rendering=rendering,
        )
        all_indices = range(len(candidates))
        return self._meter.objective(candidates, seen).score(all_indices)

    def measure(self, variant: Variant, predicted: LiveAnswer) -> LiveAnswer:
        """Figures of the working sensors by the detector, on the same frames.

        predicted: the surrogate's figures of the variant; AP, its interval and recall are replaced,
        all others are kept."""
        from placement_env.report.planning.judging import Judge

        working_variant = variant.working_variant
        setting = replace(
            self.asked_setting,
            site=self._yard.site,
            candidates=self._yard.candidates(working_variant),
            fidelity="detector",
        )
        judge = Judge.from_preparation(
            Preparation(setting, self.preparation.run), self.preparation.run.seed
        )
        set_of_all = np.ones((1, len(working_variant.sensors)), np.bool_)
        (judgement,) = judge.judge(set_of_all)
        return replace(
            predicted,
            what="measured",
            ap=judgement.ap,
            low=judgement.low,
            high=judgement.high,
            recall=judgement.recall,
        )

    def hold_back(self, hold: Callable[[], bool]) -> None:
        """Let the making of panoramas pause between frames while `hold()` is true.

        It goes on nevertheless if another thread needs rays."""
        for preparation in (self.preparation, self.all_frames.preparation):
            hold_back(preparation, hold)

    def fetch(
        self, list_variants: Callable[[], tuple[Variant, ...]], lock: AbstractContextManager[object]
    ) -> None:
        """Make one missing view of all frames, or show their figures if no view is missing.

        list_variants: function that returns the variants whose sensors need views; lock: held while
        the figures of all frames replace those of the first."""

        def show(preparation: Preparation) -> None:
            """Score by all frames from now on."""
            with lock:
                self._start_question(self.asked_setting, preparation.run, preparation)
                self.all_frames.end()
                self._earlier_answer = None

        def list_candidates() -> list[Candidates]:
            """Sensors whose views are needed, by variant."""
            return [self._yard.candidates(variant) for variant in list_variants()]

        self.all_frames.fetch(list_candidates, show)

    def make_suggester(self, estimate: Callable[[Variant], LiveAnswer]) -> Suggester:
        """Suggester of changes by the present question.

        estimate: function that returns the figures of any variant."""
        return Suggester(yard=self._yard, meter=self._meter, views=self.views, estimate=estimate)


def _describe_question(setting: Setting) -> dict[str, object]:
    """Fields of a setting that `LiveScorer.question` compares, as JSON values."""
    has_price_limit = not math.isinf(setting.most_price)
    return {
        "classes": [*setting.counted.names],
        "iou": [*setting.cases.ious],
        "errors": [*setting.cases.names],
        "scheme": setting.fusion.name,
        "most_price": setting.most_price if has_price_limit else None,
    }
