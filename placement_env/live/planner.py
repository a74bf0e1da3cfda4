"""`LivePlanner`: sensors moved by hand, each move answered by figures within a tenth of a second.

The view of a sensor is looked up in panoramas from its pole (`placement_env.fidelity.panorama`),
and a set is scored by the surrogate, as in `coview/SensorPose-v0`. The first answer at an unused
height is coarse: it is interpolated between half metres, or taken from the nearest known height.
`refine` renders the missing panoramas one by one, then the views of the whole stock that `suggest`
chooses from. One thread may refine while another moves sensors."""

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

LIVE_FRAMES = 60  # frames of traffic without a plan
LIVE_SEED = 3  # seed of the traffic without a plan


class LivePlanner(VariantEditor):
    """Plan that is made by hand.

    A copy, also a pickled one, has the same variants, views and steps to undo. Its changes do not
    reach the original, and nobody listens to them.

    site: a site, its name or file, the folder of a plan, or a setting by the surrogate whose
    candidates are the stock (None for the site's pool); a plan decides frames, seed and the largest
    number of sensors unless they are given; frames, seed: number of frames and seed of the traffic;
    run: cache and more, in place of frames and seed; first_frames: smaller number of frames, whose
    figures are shown until `refine` has made the views of all; most_sensors: largest number of
    sensors without a problem. Raises ValueError for a setting without a surrogate."""

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
        """Find the plan and its setting, and make the yard and the scorer."""
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
        self.priced_stock = setting.candidates if isinstance(setting.candidates, Stock) else Stock()
        self.catalogue = self.priced_stock.catalogue
        self.currency = self.priced_stock.currency
        yard = Yard.from_stock(
            place,
            stock=_find_stock(setting),
            sensors=place.sensors,
            keep_out=self.priced_stock.keep_out,
        )
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
        """Change the setting, and return the figures by it in the same traffic.

        changes: fields of `Setting`: classes, cases, scheme, most_price. Raises ValueError and
        OSError for a setting without a surrogate, and keeps the present one."""
        with self._lock:
            self.scorer.ask(changes)
            self._notify(False)  # no move of a drag
            return self.answer("another question")

    @property
    def first_setting(self) -> Setting:
        """Setting at the start, as it was given."""
        return self.scorer.first_setting

    @property
    def asked_setting(self) -> Setting:
        """Setting that `ask` has made, or the one at the start, as it was given."""
        return self.scorer.asked_setting

    @property
    def setting(self) -> Setting:
        """Present setting with the yard's stock as candidates, scored by the surrogate."""
        return self.scorer.setting

    @property
    def preparation(self) -> Preparation:
        """Traffic and views of the present setting; only the first frames until all are viewed."""
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
        """View without a sensor: the road users that count, in all frames."""
        return self.scorer.unseen

    @property
    def frames(self) -> int:
        """Number of frames of traffic."""
        return self.preparation.frames

    @property
    def coarse(self) -> bool:
        """True if the shown figures are of the first frames only, or a view is interpolated."""
        return self.scorer.is_coarse(self.variant)

    def look(self, candidates: Candidates) -> tuple[Visibility, bool]:
        """View of a variant's sensors, and True if one is interpolated between heights."""
        return self.scorer.views.look(candidates)

    def score(self) -> Score:
        """Score of the working sensors by the objective, on the same frames.

        Views are from panoramas at their exact heights, or from rays if the setting's rendering is
        "full"."""
        return self.scorer.score(self.variant)

    def measure(self) -> LiveAnswer:
        """Figures by the detector in place of the surrogate's, on the same frames, with the
        setting's errors.

        Raises ValueError if the plan has another detector than the shipped one, which the setting
        lacks."""
        if self.plan is not None:
            _check_detector(self.plan, self.asked_setting)
        predicted = self.finish()
        return self.scorer.measure(self.variant, predicted)

    # what takes longer

    def refine(self, hold: Callable[[], bool] = lambda: False) -> bool:
        """Make one missing view; False if no view is missing.

        The sensors come first, then other heights of their poles, the nearest first, then the
        stock. It may run in a separate thread, which waits between frames while `hold` is true and
        no other thread casts rays."""
        self.scorer.hold_back(hold)
        if self.scorer.all_frames.are_awaited:
            self._fetch()
            return True
        return self.scorer.views.refine(self.variant)

    def _fetch(self) -> None:
        """Make one missing view of all frames, or show the figures of all frames."""
        self.scorer.fetch(lambda: (self.variant, *self.variants.values()), self._lock)

    def finish(self) -> LiveAnswer:
        """Figures of the variant that is shown, without anything coarse."""
        while (answer := self.answer()).coarse:
            self.refine()  # makes a part of it exact
        return answer

    def suggest(
        self,
        kind: str = "add",
        name: str | None = None,
        count: int = 3,
        *,
        patience: float = math.inf,
    ) -> tuple[Suggestion, ...]:
        """Return the changes that raise the AP most, or fewer if nothing helps.

        kind: "add" for the best next sensor, "move" for the best place of one sensor, "remove" for
        the sensors whose loss costs least; name: sensor to move, None for others; count: number of
        changes; patience: time (s) to look from new poles, extended until a pose fits; inf for
        every pole. Raises ValueError for an unknown kind or sensor, and for a stock without a free
        place."""
        while self.scorer.all_frames.are_awaited:
            self._fetch()
        suggester = self.scorer.make_suggester(self.estimate)
        return suggester.suggest(self.variant, kind, name, count=count, patience=patience)

    def search(self, stop: Callable[[], bool] = lambda: False) -> Iterator[LiveAnswer]:
        """Move one unlocked sensor after another to its best place, until no move helps.

        Yields the figures of each improvement, which is shown and can be undone. stop: function
        that returns True to end the search."""
        waiting_names = self.variant.movable_names  # names of sensors that may move, in a new list
        while waiting_names and not stop():
            name = waiting_names.pop(0)
            if name not in {sensor.name for sensor in self.sensors}:
                continue  # another thread removed it
            before = self.finish()
            best = next(iter(self.suggest("move", name, count=1)), None)
            if best is not None and best.answer.ap > before.ap + MIN_HELPFUL_GAIN_AP and not stop():
                yield self.accept(best)
                # a move may help all others now
                waiting_names = self.variant.movable_names
                waiting_names.remove(name)


def _check_detector(plan: PlanFolder, question: Setting) -> None:
    """Raise ValueError if a plan was made with a detector that the setting lacks.

    plan: its `own_detector` names the detector, None for the shipped one; question: setting by
    which sets are scored now, its `detector` None for the shipped one."""
    if plan.own_detector is not None and question.detector is None:
        remedy = (
            "LivePlanner(plan.ask(replace(plan.setting, detector=...))), plan = "
            "read_plan_folder(folder)"
        )
        raise ValueError(
            f"the plan's detector is {plan.own_detector}, which is not loaded: {remedy}"
        )


def _find_setting(site: object) -> Setting:
    """Return a setting as it is, or the usual one of a site, its name or file."""
    if isinstance(site, Setting):
        return site
    return Setting(site if isinstance(site, Site) else str(site))


def _find_plan(site: object) -> PlanFolder | None:
    """Return a plan that was read, or read from its folder; None for anything else."""
    if isinstance(site, PlanFolder):
        return site
    return read_plan_folder(str(site)) if is_plan_folder(site) else None


def _find_stock(setting: Setting) -> Candidates:
    """Sensors and poses to choose from: a setting's, else the site's pool, else its sensors.

    The paper's candidates, which are the site's sensors, are too few to choose from."""
    if setting.candidates is not None and setting.candidates != "paper":
        return setting.pool
    try:
        return pool(setting.place)
    except NoCandidates:
        return paper_candidates(setting.place)
