"""`LivePlanner`: sensors moved by hand, each move answered by figures within a tenth of a second.

A sensor is seen in panoramas from its pole (`placement_env.fidelity.panorama`), a set scored by the
surrogate, as in `coview/SensorPose-v0`. At a height that was never used the first answer is coarse,
between the half metres below and above or from the next height known; `refine` makes what is
missing, a panorama at a time, then the views of the whole stock, of which `suggest` chooses. One
thread may refine while another moves."""

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from placement_env.candidates.candidates import Candidates, NoCandidates, paper_candidates, pool
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.visibility import Visibility
from placement_env.live.editor import VariantEditor
from placement_env.live.figures import LiveAnswer
from placement_env.live.scorer import LiveScorer
from placement_env.live.suggestions import MIN_HELPFUL_GAIN_AP, Suggestion
from placement_env.live.variant import Yard
from placement_env.objective import Score
from placement_env.report.planning.plan_folder import (
    PlanFolder,
    StatedFigure,
    is_plan_folder,
    read_plan_folder,
)
from placement_env.report.planning.question import Stock
from placement_env.setting import Setting
from toolkit.runtime.run import Run
from toolkit.sites.site import Site

LIVE_FRAMES = 60
LIVE_SEED = 3


class LivePlanner(VariantEditor):
    """Plan by hand.

    A copy, also one that is pickled, has the same variants, views and steps to undo, and goes on
    without the original: its changes are told to nobody.

    site: a site, its name or file, the folder of a plan, or a setting: its fidelity must be the
    surrogate, its candidates are the stock (the site's pool without any). A plan brings its frames,
    seed and number of sensors. frames, seed: of the traffic; run: cache and more, in place of
    frames and seed; first_frames: fewer, of traffic of their own, whose figures are shown until
    `refine` has made the views of all; most_sensors: beyond which an answer names a problem. Raises
    ValueError where the setting has no surrogate."""

    def __init__(
        self,
        site: Setting | Site | str | Path | PlanFolder,
        frames: int | None = None,
        seed: int | None = None,
        *,
        run: Run | None = None,
        first_frames: int | None = None,
        most_sensors: float = math.inf,
    ) -> None:
        self.plan = _find_plan(site)
        usual_run = Run(frames=LIVE_FRAMES, seed=LIVE_SEED)
        if self.plan is None:
            setting = _find_setting(site)
        else:
            setting = self.plan.setting
            most_sensors = min(most_sensors, self.plan.sensors)
            usual_run = Run(frames=self.plan.frames, seed=self.plan.seed)
        frames = usual_run.frames if frames is None else frames
        seed = usual_run.seed if seed is None else seed
        place = setting.place
        self.sold = setting.candidates if isinstance(setting.candidates, Stock) else Stock()
        self.catalogue = self.sold.catalogue
        self.currency = self.sold.currency
        yard = Yard.of(place, _offer(setting), place.sensors, self.sold.keep_out)
        self.most_sensors = most_sensors
        scorer = LiveScorer(
            yard,
            setting,
            run or Run(frames=frames, seed=seed),
            first_frames=first_frames,
            currency=self.currency,
            max_sensors=most_sensors,
        )
        super().__init__(yard, scorer)

    def ask(self, **changes: Any) -> LiveAnswer:
        """Score by other classes, cases or scheme, or within another price, in the same traffic.

        changes: fields of `Setting`: classes, cases, scheme, most_price. Raises ValueError and
        OSError where nothing predicts that, and keeps the question that was."""
        with self._lock:
            self.scorer.ask(changes)
            self.tell(False)
            return self.answer("another question")

    @property
    def first(self) -> Setting:
        """The question at the start."""
        return self.scorer.first

    @property
    def asked(self) -> Setting:
        """The present question."""
        return self.scorer.asked

    @property
    def setting(self) -> Setting:
        """The present question, about the yard's stock, by the surrogate."""
        return self.scorer.setting

    @property
    def preparation(self) -> Preparation:
        """Traffic of the present question."""
        return self.scorer.preparation

    @property
    def question(self) -> dict[str, object]:
        """Changes that `ask` has made since the start, for JSON: classes, iou, errors, scheme and
        most_price."""
        return self.scorer.question

    @property
    def stated(self) -> StatedFigure | None:
        """Figure that the plan states by its detector, None without a plan and once another
        question is asked."""
        return None if self.plan is None or self.question else self.plan.stated

    @property
    def unseen(self) -> Visibility:
        """The road users that count, in all frames."""
        return self.scorer.unseen

    @property
    def frames(self) -> int:
        """Number of frames of traffic."""
        return self.preparation.frames

    @property
    def coarse(self) -> bool:
        """True where the figures shown are of few frames, or a view is not from its very height."""
        return self.scorer.is_coarse(self.variant)

    def look(self, candidates: Candidates) -> tuple[Visibility, bool]:
        """View of the sensors of a variant; True where one is not from its very height."""
        return self.scorer.views.look(candidates)

    def score(self) -> Score:
        """The objective's own score of the sensors that work, on the same frames, in panoramas from
        where they hang. With the setting's rendering "full" every ray is cast."""
        return self.scorer.score(self.variant)

    def measure(self) -> LiveAnswer:
        """Figures by the detector in place of the surrogate's, on the same frames, with the
        setting's errors.

        Raises ValueError for a plan with a detector of its own that the setting lacks."""
        if self.plan is not None:
            _check_detector(self.plan, self.asked)
        predicted = self.finish()
        return self.scorer.measure(self.variant, predicted)

    # what takes longer

    def refine(self, hold: Callable[[], bool] = lambda: False) -> bool:
        """Make one of the views that are missing: of the sensors shown, then from other heights of
        their poles, the nearest first, then of the stock. True while some are. May run in a thread
        of its own, which waits between frames while `hold` is true and no other needs rays."""
        self.scorer.hold_back(hold)
        if self.scorer.all_frames.are_awaited:
            self._fetch()
            return True
        return self.scorer.views.refine(self.variant)

    def _fetch(self) -> None:
        """Make one of the views of all frames that are missing; where none is, show figures of all
        frames."""
        self.scorer.fetch(lambda: (self.variant, *self.variants.values()), self._lock)

    def finish(self) -> LiveAnswer:
        """Figures of the variant that is shown, without anything coarse."""
        while (answer := self.answer()).coarse:
            self.refine()
        return answer

    def suggest(
        self,
        kind: str = "add",
        name: str | None = None,
        count: int = 3,
        *,
        patience: float = math.inf,
    ) -> tuple[Suggestion, ...]:
        """Changes that raise the AP most: kind add for the best next sensor, move for the best
        place of sensor `name`, remove for the sensors that are missed least. Fewer where nothing
        helps.

        patience: s to look from poles that nobody has looked from, again while none fits; inf: from
        a height of each.

        Raises ValueError for an unknown kind or sensor, and where the stock has no place left."""
        while self.scorer.all_frames.are_awaited:
            self._fetch()
        suggester = self.scorer.make_suggester(self.estimate)
        return suggester.suggest(self.variant, kind, name, count=count, patience=patience)

    def search(self, stop: Callable[[], bool] = lambda: False) -> Iterator[LiveAnswer]:
        """Improve the variant from where it is: the best place for one unlocked sensor after
        another, until none helps.

        Yields an answer for each improvement, which is shown and can be undone."""
        waiting = self.variant.movable
        while waiting and not stop():
            name = waiting.pop(0)
            if name not in {sensor.name for sensor in self.sensors}:
                continue
            before = self.finish()
            best = next(iter(self.suggest("move", name, count=1)), None)
            if best is not None and best.answer.ap > before.ap + MIN_HELPFUL_GAIN_AP and not stop():
                yield self.accept(best)
                waiting = self.variant.movable
                waiting.remove(name)


def _check_detector(plan: PlanFolder, question: Setting) -> None:
    """Raise ValueError for a plan with a detector of its own that the question lacks."""
    if plan.own_detector is not None and question.detector is None:
        loaded = (
            "LivePlanner(plan.ask(replace(plan.setting, detector=...))), plan = "
            "read_plan_folder(folder)"
        )
        raise ValueError(
            f"the plan's detector is {plan.own_detector}, which is not loaded: {loaded}"
        )


def _find_setting(site: object) -> Setting:
    if isinstance(site, Setting):
        return site
    return Setting(site if isinstance(site, Site) else str(site))


def _find_plan(site: object) -> PlanFolder | None:
    if isinstance(site, PlanFolder):
        return site
    return read_plan_folder(str(site)) if is_plan_folder(site) else None


def _offer(setting: Setting) -> Candidates:
    """Stock of a setting: its candidates, else the site's pool, else the site's own sensors."""
    if setting.candidates is not None and setting.candidates != "paper":
        return setting.pool
    try:
        return pool(setting.place)
    except NoCandidates:
        return paper_candidates(setting.place)
