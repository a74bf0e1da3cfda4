"""`LivePlanner`: sensors moved by hand, each move answered by figures within a tenth of a second.

A sensor is seen in panoramas from its pole (`placement_env.fidelity.panorama`), a set scored by the
surrogate, as in `coview/SensorPose-v0`. At a height that was never used the first answer is coarse,
between the half metres below and above or from the next height known; `refine` makes what is
missing, a panorama at a time, then the views of the whole stock, of which `suggest` chooses. One
thread may refine while another moves."""

import math
from collections.abc import Callable, Iterable, Iterator
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock, RLock
from typing import Any

import numpy as np

from placement_env.candidates.candidates import (
    Candidates,
    NoCandidates,
    aim_sensor,
    paper_candidates,
    pool,
)
from placement_env.fidelity.panorama import LiveView, list_heights, make_table_ahead
from placement_env.fidelity.preparation import Preparation
from placement_env.fidelity.seeing import see
from placement_env.fidelity.traffic import FRAMES
from placement_env.fidelity.visibility import Visibility
from placement_env.live.figures import LiveAnswer, Meter
from placement_env.live.picture import GroundPicture
from placement_env.live.stock_views import StockViews, join_views
from placement_env.live.variant import (
    TILT_SPAN,
    Corners,
    LiveSensor,
    Variant,
    Where,
    Yard,
    check_area,
    check_name,
    name_on_pole,
)
from placement_env.objective import Score
from placement_env.report.planning.plan_folder import (
    PlanFolder,
    StatedFigure,
    is_plan_folder,
    read_plan_folder,
)
from placement_env.report.planning.question import Stock
from placement_env.setting import Rendering, Setting
from toolkit.arrays import Mask
from toolkit.runtime.run import Run
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

LIVE_FRAMES = 60
LIVE_SEED = 3
LIVE_BYTES = 190_000_000  # of panoramas in memory
KEPT_STEPS = 2000  # that can be undone
# views of single sensors and figures of variants in memory
KEPT_VIEWS = 512
KEPT_ANSWERS = 128
USUAL_TILT = 0.3  # rad below the horizon, around which tables are made first
# points, distance, sent, far of one sensor
Row = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
# rad of heading and tilt that a suggestion is turned by
TRIED = ((0.2, 0.0), (-0.2, 0.0), (0.0, 0.09), (0.0, -0.09))


@dataclass(frozen=True)
class Suggestion:
    """A change that pays: `kind` is add, move or remove; sensor: as it would hang, or hangs;
    answer: figures then; considered: number of poses of the stock that were compared."""

    kind: str
    sensor: LiveSensor
    answer: LiveAnswer
    considered: int


def _tell_nobody(dragging: bool) -> None:
    pass


class LivePlanner:
    """Plan by hand.

    A copy, also one that is pickled, has the same variants, views and steps to undo, and goes on
    without the original: its changes are told to nobody.

    site: a site, its name or file, the folder of a plan, or a setting: its fidelity must be the
    surrogate, its candidates are the stock (the site's pool without any). A plan brings its frames,
    seed and number of sensors. frames, seed: of the traffic; run: cache and more, in place of
    frames and seed; first_frames: fewer, of traffic of their own, whose figures are shown until
    `refine` has made the views of all; most_sensors: beyond which an answer names a problem. Raises
    ValueError where the setting has no surrogate."""

    preparation: Preparation

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
        if self.plan is None:
            setting = _find_setting(site)
            usual_frames = LIVE_FRAMES
            usual_seed = LIVE_SEED
        else:
            setting = self.plan.setting
            most_sensors = min(most_sensors, self.plan.sensors)
            usual_frames = self.plan.frames
            usual_seed = self.plan.seed
        frames = usual_frames if frames is None else frames
        seed = usual_seed if seed is None else seed
        stock = setting.candidates
        place = setting.place
        sold = stock if isinstance(stock, Stock) else Stock()
        self.sold = sold
        self.catalogue = sold.catalogue
        self.currency = sold.currency
        self.yard = Yard.of(place, _offer(setting), place.sensors, sold.keep_out)
        self._stand_alone()
        self.first = setting
        self.most_sensors = most_sensors
        whole = run or Run(frames=frames, seed=seed)
        fewer = first_frames is not None and first_frames < whole.frames_or(FRAMES)
        self._open(setting, replace(whole, frames=first_frames, cache=None) if fewer else whole)
        # of all frames, where few are shown
        self._whole = replace(self.preparation, run=whole) if fewer else None
        start = self.yard.place(place.sensors)
        self.variants: dict[str, Variant] = {"A": start}
        self.picture: GroundPicture | None = None  # under the scene
        self.current = "A"
        self._past: list[tuple[str, Variant]] = []
        self._future: list[tuple[str, Variant]] = []
        self._before: LiveAnswer | None = None
        self._dragging: str | None = None

    def _stand_alone(self) -> None:
        """Begin without threads and listeners."""
        self._lock = RLock()
        self._fetching = Lock()
        self.tell: Callable[[bool], None] = (
            _tell_nobody  # called after every change, before its answer
        )

    def __getstate__(self) -> dict[str, Any]:
        with self._fetching, self._lock:
            state = dict(self.__dict__)
        for name in ("_lock", "_fetching", "tell"):
            del state[name]
        for name in ("variants", "_past", "_future", "_views", "_answers"):
            state[name] = copy(state[name])
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._stand_alone()

    def _open(self, asked: Setting, run: Run, before: Preparation | None = None) -> None:
        """Prepare for a question, in the traffic of the preparation before."""
        if len(asked.cases.ious) > 1:
            raise ValueError(f"live figures are of one IoU, got {asked.cases.iou}: give one")
        setting = replace(asked, candidates=self.yard.stock).with_fidelity("surrogate")
        made = Preparation(setting, run)
        made.check()
        known = None if before is None else self.preparation.live
        self.asked = asked
        self.setting = setting
        self.preparation = made.plain
        if before is not None:
            self.preparation.take_traffic(before)
        self._meter = Meter(self.preparation, self.currency)
        self._answers = dict[Variant, LiveAnswer]()
        if known is None or known is not self.preparation.live:
            self._views = dict[object, tuple[Row, bool]]()
            self._stock = StockViews(self.preparation)
            if self.preparation.live is not None:
                self.preparation.live.limit(LIVE_BYTES)

    def ask(self, **changes: Any) -> LiveAnswer:
        """Score by other classes, cases or scheme, or within another price, in the same traffic.

        changes: fields of `Setting`: classes, cases, scheme, most_price. Raises ValueError and
        OSError where nothing predicts that, and keeps the question that was."""
        with self._lock:
            before = self.preparation
            self._open(replace(self.asked, **changes), before.run, before)
            self._before = None
            self.tell(False)
            return self.answer("another question")

    @property
    def question(self) -> dict[str, object]:
        """Changes that `ask` has made since the start, for JSON: classes, iou, errors, scheme and
        most_price."""
        first = _describe_question(self.first)
        now = _describe_question(self.asked)
        return {name: value for name, value in now.items() if value != first[name]}

    @property
    def stated(self) -> StatedFigure | None:
        """Figure that the plan states by its detector, None without a plan and once another
        question is asked."""
        return None if self.plan is None or self.question else self.plan.stated

    @property
    def variant(self) -> Variant:
        """The variant that is shown."""
        return self.variants[self.current]

    @property
    def sensors(self) -> tuple[LiveSensor, ...]:
        """Sensors of the variant."""
        return self.variant.sensors

    @property
    def unseen(self) -> Visibility:
        """The road users that count, in all frames."""
        return self._meter.unseen

    @property
    def frames(self) -> int:
        """Number of frames of traffic."""
        return self.preparation.frames

    def move(
        self,
        name: str,
        heading: float | None = None,
        tilt: float | None = None,
        height: float | None = None,
        position: Where | None = None,
        *,
        dragging: bool = False,
    ) -> LiveAnswer:
        """Turn (rad), tilt (rad below the horizon), raise (m above the foot) or carry a sensor to a
        pole or place. Heights and tilts stay within those of the pole and `TILT_SPAN`. dragging:
        moves of one sensor in a row are undone as one. Raises ValueError for an unknown or locked
        sensor, a tilt beyond straight down, and a place where no pole can stand."""
        with self._lock:
            variant = self.variant
            sensor = self._free(name)
            if position is not None:
                mount, variant = self.yard.stand(variant, position)
                if mount.name != sensor.mount:
                    self._check_room(variant, mount.name)
                    x, y, _ = mount.position.tolist()
                    sensor = replace(sensor, mount=mount.name, x=x, y=y)
            mount = self.yard.find_mount(variant, sensor.mount)
            up = sensor.height if height is None else _finite("height", height)
            around = sensor.heading if heading is None else _finite("heading", heading)
            down = sensor.tilt if tilt is None else _check_tilt(tilt)
            least_tilt = min(TILT_SPAN[0], sensor.tilt)
            most_tilt = max(TILT_SPAN[1], sensor.tilt)
            low, high = min(mount.min_height, sensor.height), max(mount.max_height, sensor.height)
            if position is not None:
                low, high = mount.min_height, mount.max_height
            moved = replace(
                sensor,
                height=float(np.clip(up, low, high)),
                heading=around if around == sensor.heading else math.remainder(around, math.tau),
                tilt=float(np.clip(down, least_tilt, most_tilt)),
            )
            again = dragging and self._dragging == name
            answer = self._become(variant.with_sensor(moved), f"{name} moved", again=again)
            self._dragging = name if dragging else None
            return answer

    def add(
        self,
        mount: Where,
        heading: float = 0.0,
        tilt: float = 0.26,
        height: float | None = None,
        *,
        model: str | None = None,
        name: str | None = None,
    ) -> LiveAnswer:
        """Mount a sensor on a pole or place. height: None for the highest; model: name in the
        stock, None for its first; name: None for a free one. Raises ValueError as `move`."""
        with self._lock:
            model = model or next(iter(self.yard.models))
            if name is not None and name in {sensor.name for sensor in self.sensors}:
                raise ValueError(f"there is a sensor {name!r} already: give another name")
            pole, variant = self.yard.stand(self.variant, mount)
            name = check_name(name) if name else name_on_pole(self.variant, pole.name)
            self._check_room(variant, pole.name)
            up = (
                pole.max_height
                if height is None
                else float(np.clip(height, pole.min_height, pole.max_height))
            )
            x, y, _ = pole.position.tolist()
            down = float(np.clip(_check_tilt(tilt), *TILT_SPAN))
            made = LiveSensor(name, model, pole.name, x, y, up, _finite("heading", heading), down)
            after = self.yard.check(replace(variant, sensors=(*variant.sensors, made)))
            return self._become(after, f"{name} added")

    def end_drag(self) -> None:
        """Let the next move be a step of its own, and save."""
        self._dragging = None
        self.tell(False)

    def remove(self, name: str) -> LiveAnswer:
        """Take a sensor away. Raises ValueError for an unknown or locked one."""
        with self._lock:
            self._free(name)
            return self._become(_without(self.variant, name), f"{name} removed")

    def duplicate(self, name: str) -> LiveAnswer:
        """Mount a copy of a sensor on the nearest pole with room. Raises ValueError where none
        has."""
        with self._lock:
            sensor = self.variant.find(name)
            free = [
                m
                for m in (*self.yard.stock.mounts, *self.variant.poles)
                if self._room(self.variant, m.name)
            ]
            if not free:
                raise ValueError(
                    "no pole has room for another sensor: remove one, or give a place of its own"
                )
            nearest = min(
                free,
                key=lambda mount: float(np.hypot(*(mount.position[:2] - (sensor.x, sensor.y)))),
            )
            return self.add(
                nearest.name, sensor.heading, sensor.tilt, sensor.height, model=sensor.model
            )

    def lock(self, name: str, locked: bool = True) -> LiveAnswer:
        """Keep a sensor from being moved, or let it be moved again."""
        with self._lock:
            sensor = replace(self.variant.find(name), locked=locked)
            return self._become(
                self.variant.with_sensor(sensor), f"{name} {'' if locked else 'un'}locked"
            )

    def fail(self, name: str, failed: bool = True) -> LiveAnswer:
        """Let a sensor fail, or work again."""
        with self._lock:
            sensor = replace(self.variant.find(name), failed=failed)
            return self._become(
                self.variant.with_sensor(sensor), f"{name} {'failed' if failed else 'works again'}"
            )

    def set_keep_out(self, areas: Iterable[Corners]) -> LiveAnswer:
        """Let no pole be used within areas, each given by its corners. Raises ValueError for what
        is no area."""
        with self._lock:
            return self._become(
                replace(self.variant, keep_out=tuple(map(check_area, areas))), "keep-out areas"
            )

    def lay(self, picture: GroundPicture | None) -> None:
        """Lay a picture under the scene, or take it away."""
        self.picture = picture
        self.tell(False)

    def undo(self) -> LiveAnswer:
        """Take the last change back. Raises ValueError where there is none."""
        return self._step(self._past, self._future, "undo")

    def redo(self) -> LiveAnswer:
        """Do the last change again that was taken back. Raises ValueError where there is none."""
        return self._step(self._future, self._past, "redo")

    def show(self, name: str, *, copy: bool = False) -> LiveAnswer:
        """Show a variant. copy: a new one, like the present. Raises ValueError for an unknown name,
        or a taken one."""
        with self._lock:
            if copy == (check_name(name) in self.variants):
                known = ", ".join(self.variants)
                raise ValueError(
                    f"{name!r} is {'taken' if copy else 'unknown'}: the variants are {known}"
                )
            before = self.answer()
            if copy:
                self.variants[name] = self.variant
            self.current = name
            self._dragging = None
            self._before = before
            self.tell(False)
            return self.answer(f"variant {name}")

    def answer(self, what: str = "") -> LiveAnswer:
        """Figures of the variant that is shown, and what changed since those before."""
        with self._lock:
            return self.estimate(self.variant).since(self._before, what)

    def estimate(self, variant: Variant) -> LiveAnswer:
        """Figures of any variant."""
        with self._lock:
            found = self._answers.get(variant)
            return found if found is not None and not found.coarse else self._estimate(variant)

    def _estimate(self, variant: Variant) -> LiveAnswer:
        yard, (candidates, seen, standing, coarse) = self.yard, self._see(variant)
        poles = [yard.find_mount(variant, each.mount) for each in variant.sensors]
        barred = [
            each.name
            for each, pole in zip(variant.sensors, poles, strict=True)
            if yard.bars(variant, pole)
        ]
        said = tuple(f"{name} hangs in a keep-out area" for name in barred)
        if len(variant.sensors) > self.most_sensors:
            said += (
                (
                    f"it has {len(variant.sensors)} sensors, more than the {self.most_sensors} of "
                    "its plan"
                ),
            )
        found = self._meter.measure(candidates, seen, standing)
        found = replace(
            found, coarse=coarse or self._whole is not None, problems=found.problems + said
        )
        if len(self._answers) > KEPT_ANSWERS:
            self._answers.clear()
        self._answers[variant] = found
        return found

    @property
    def coarse(self) -> bool:
        """True where the figures shown are of few frames, or a view is not from its very height."""
        return self._whole is not None or self.look(self.yard.candidates(self.variant))[1]

    def _see(self, variant: Variant) -> tuple[Candidates, Visibility, Mask, bool]:
        """Candidates of a variant, their view, which of them have not failed, and whether the view
        is coarse."""
        candidates = self.yard.candidates(variant)
        seen, coarse = self.look(candidates)
        return (
            candidates,
            seen,
            np.array([not each.failed for each in variant.sensors], np.bool_),
            coarse,
        )

    def look(self, every: Candidates) -> tuple[Visibility, bool]:
        """View of the sensors of a variant; True where one is not from its very height."""
        live = self.preparation.live
        coarse = False
        rows: list[Row] = []
        for k, sensor in enumerate(every.sensors):
            key = (sensor.model, sensor.pose.tobytes())
            row, fine = self._views.get(key, (None, False))
            if row is None or (not fine and live is not None and live.knows(sensor)):
                # asked before, as another thread may refine
                fine = live is None or live.knows(sensor)
                alone = every.select([k])
                labels = self.setting.counted.labels
                if live is None:
                    seen = see(self.preparation.traffic, alone, labels=labels, rendering="full")
                else:
                    seen = live.see(alone, reach="nearest")
                row = (seen.points[0], seen.distance[0], seen.sent[0], seen.far[0])
                while len(self._views) >= KEPT_VIEWS:
                    self._views.pop(next(iter(self._views)), None)
                self._views[key] = row, fine
            rows.append(row)
            coarse |= not fine
        return join_views(self._meter.unseen, rows), coarse

    def score(self) -> Score:
        """The objective's own score of the sensors that work, on the same frames, in panoramas from
        where they hang. With the setting's rendering "full" every ray is cast."""
        working = replace(
            self.variant, sensors=tuple(each for each in self.sensors if not each.failed)
        )
        candidates = self.yard.candidates(working)
        labels = self.setting.counted.labels
        rendering = self.setting.rendering
        how: Rendering = "panorama" if rendering == "auto" else rendering
        seen = see(self.preparation.traffic, candidates, labels=labels, rendering=how)
        return self._meter.objective(candidates, seen).score(range(len(candidates)))

    def refine(self, hold: Callable[[], bool] = lambda: False) -> bool:
        """Make one of the views that are missing: of the sensors shown, then from other heights of
        their poles, the nearest first, then of the stock. True while some are. May run in a thread
        of its own, which waits between frames while `hold` is true and no other needs rays."""
        for made in (self.preparation, self._whole):
            if made is not None and made.live is not None:
                made.live.hold = hold
        if self._whole is not None:
            self._fetch()
            return True
        live = self.preparation.live
        if live is None:
            return False
        every = self.yard.candidates(self.variant)

        def make(wanted: Iterable[tuple[int, Sensor]]) -> bool:
            return any(_look(live, every, k, sensor) for k, sensor in wanted)

        models = dict.fromkeys(sensor.model for sensor in every.sensors)
        if make(enumerate(every.sensors)) or any(
            make_table_ahead(model, *TILT_SPAN, USUAL_TILT) for model in models
        ):
            return True
        above = [
            (
                k,
                np.array(
                    [
                        0.0,
                        0.0,
                        every.mounts[every.mount[k]].position[2] + height - sensor.position[2],
                    ]
                ),
            )
            for k, sensor in enumerate(every.sensors)
            for height in list_heights(every.mounts[every.mount[k]])
        ]
        above.sort(key=lambda each: abs(each[1][2]))
        others = (
            (k, aim_sensor(every.sensors[k], every.sensors[k].position + up, 0.0, 0.0))
            for k, up in above
        )
        # where memory is full they would push each other out for ever
        return (not live.full and make(others)) or self._stock.look_further()

    def _fetch(self) -> None:
        """Make one of the views of all frames that are missing; where none is, show figures of all
        frames."""
        with self._fetching:
            if (whole := self._whole) is None:
                return
            shown = [self.yard.candidates(each) for each in (self.variant, *self.variants.values())]
            rows = ((every, k, sensor) for every in shown for k, sensor in enumerate(every.sensors))
            if whole.live is not None and any(_look(whole.live, *row) for row in rows):
                return
            with self._lock:
                self._open(self.asked, whole.run, whole)
                self._whole = None
                self._before = None

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
        while self._whole is not None:
            self._fetch()
        variant = self.variant
        if kind == "remove":
            free = [each for each in variant.sensors if not each.locked]
            fewer = [
                replace(variant, sensors=tuple(s for s in variant.sensors if s is not each))
                for each in free
            ]
            found = [
                Suggestion(kind, each, self.estimate(v), 0)
                for each, v in zip(free, fewer, strict=True)
            ]
            return tuple(sorted(found, key=lambda each: -each.answer.ap)[:count])
        if kind not in ("add", "move") or (kind == "move" and name is None):
            raise ValueError(
                f"kind must be add, remove, or move with the name of a sensor, got {kind!r} and "
                f"{name!r}"
            )
        taken = None if name is None or kind == "add" else self._free(name)
        rest = tuple(each for each in variant.sensors if each is not taken)
        base = replace(variant, sensors=rest)
        candidates, seen, standing, _ = self._see(base)
        room = np.array(
            [
                self._room(base, m.name) and not self.yard.bars(base, m)
                for m in self.yard.stock.mounts
            ]
        )
        ranked = list[int]()
        more = True
        while more and not ranked:
            more = self._stock.at_least_coarse(patience, room)
            ranked = self._stock.rank(candidates, seen, standing, self._meter.objective)
        found = []
        poles = set[int]()
        for candidate in ranked:
            mount = int(self.yard.stock.mount[candidate])
            if mount in poles or not room[mount]:
                continue
            poles.add(mount)
            found.append(self._improve(kind, base, self._hang(base, candidate, taken)))
            if len(found) == count:
                break
        return tuple(sorted(found, key=lambda each: -each.answer.ap))

    def accept(self, suggestion: Suggestion) -> LiveAnswer:
        """Make a suggested change."""
        with self._lock:
            sensor = suggestion.sensor
            variant = self.variant
            if suggestion.kind == "remove":
                return self.remove(sensor.name)
            if suggestion.kind == "move":
                self._free(sensor.name)
                self._check_room(_without(variant, sensor.name), sensor.mount)
                return self._become(variant.with_sensor(sensor), f"{sensor.name} moved")
            self._check_room(variant, sensor.mount)
            made = replace(sensor, name=name_on_pole(variant, sensor.mount))
            return self._become(
                replace(variant, sensors=(*variant.sensors, made)), f"{made.name} added"
            )

    def search(self, stop: Callable[[], bool] = lambda: False) -> Iterator[LiveAnswer]:
        """Improve the variant from where it is: the best place for one unlocked sensor after
        another, until none helps.

        Yields an answer for each improvement, which is shown and can be undone."""
        waiting = [each.name for each in self.sensors if not each.locked and not each.failed]
        while waiting and not stop():
            name = waiting.pop(0)
            if name not in {each.name for each in self.sensors}:
                continue
            before = self.finish()
            best = next(iter(self.suggest("move", name, count=1)), None)
            if best is not None and best.answer.ap > before.ap + 1e-4 and not stop():
                yield self.accept(best)
                waiting = [
                    each.name for each in self.sensors if not each.locked and not each.failed
                ]
                waiting.remove(name)

    def measure(self) -> LiveAnswer:
        """Figures by the detector in place of the surrogate's, on the same frames, with the
        setting's errors.

        Raises ValueError for a plan with a detector of its own that the setting lacks."""
        from placement_env.report.planning.judging import Judge

        if (
            self.plan is not None
            and self.plan.own_detector is not None
            and self.asked.detector is None
        ):
            loaded = (
                "LivePlanner(plan.ask(replace(plan.setting, detector=...))), plan = "
                "read_plan_folder(folder)"
            )
            raise ValueError(
                f"the plan's detector is {self.plan.detector}, which is not loaded: {loaded}"
            )
        own = replace(self.finish(), what="measured")
        working = replace(
            self.variant, sensors=tuple(each for each in self.sensors if not each.failed)
        )
        stock = self.yard.candidates(working)
        asked = replace(self.asked, site=self.yard.site, candidates=stock, fidelity="detector")
        made = Preparation(asked, self.preparation.run)
        judged = Judge.of(made, self.preparation.run.seed).judge(
            np.ones((1, len(working.sensors)), np.bool_)
        )[0]
        return replace(own, ap=judged.ap, low=judged.low, high=judged.high, recall=judged.recall)

    def restore(
        self, variants: dict[str, Variant], current: str, past: Iterable[tuple[str, Variant]]
    ) -> None:
        """Take over variants and steps that were kept. Raises ValueError where they do not fit the
        site and stock."""
        steps = list(past)
        for variant in (*variants.values(), *(each for _, each in steps)):
            self.yard.check(variant)
        if current not in variants:
            raise ValueError(f"the shown variant {current!r} must be one of {', '.join(variants)}")
        with self._lock:
            self.variants = dict(variants)
            self.current = current
            self._past = steps
            self._future = []
            self._before = None
            self._dragging = None

    @property
    def past(self) -> tuple[tuple[str, Variant], ...]:
        """Steps that can be undone, the last one last."""
        return tuple(self._past)

    def _become(self, variant: Variant, what: str, *, again: bool = False) -> LiveAnswer:
        used = {sensor.mount for sensor in variant.sensors}
        variant = replace(variant, poles=tuple(pole for pole in variant.poles if pole.name in used))
        if variant != self.variant and not again:
            self._before = self._answers.get(self.variant)
            self._past.append((self.current, self.variant))
            del self._past[:-KEPT_STEPS]
        if variant != self.variant:
            self._future.clear()
        self.variants[self.current] = variant
        self._dragging = None
        self.tell(again)
        return self.answer(what)

    def _step(
        self, source: list[tuple[str, Variant]], target: list[tuple[str, Variant]], what: str
    ) -> LiveAnswer:
        with self._lock:
            if not source:
                raise ValueError(f"there is nothing to {what}")
            self._before = self._answers.get(self.variant)
            name, variant = source.pop()
            target.append((name, self.variants.get(name, variant)))
            self.variants[name] = variant
            self.current = name
            self._dragging = None
            self.tell(False)
            return self.answer(what)

    def _free(self, name: str) -> LiveSensor:
        sensor = self.variant.find(name)
        if sensor.locked:
            raise ValueError(f"{name} is locked: unlock it first")
        return sensor

    def _room(self, variant: Variant, mount: str) -> bool:
        most = self.yard.find_mount(variant, mount).max_sensors
        return sum(sensor.mount == mount for sensor in variant.sensors) < most

    def _check_room(self, variant: Variant, mount: str) -> None:
        if not self._room(variant, mount):
            raise ValueError(f"{mount} carries all the sensors that it may: take another pole")

    def _hang(self, base: Variant, candidate: int, taken: LiveSensor | None) -> LiveSensor:
        """Candidate of the stock as a sensor."""
        stock = self.yard.stock
        (sensor,) = self.yard.place([stock.sensors[candidate]]).sensors
        if taken is not None:
            return replace(sensor, name=taken.name, failed=taken.failed)
        return replace(sensor, name=name_on_pole(base, sensor.mount))

    def _improve(self, kind: str, base: Variant, sensor: LiveSensor) -> Suggestion:
        """Suggestion of a sensor, turned and tilted while that helps and makes no problem."""

        def judge(each: LiveSensor) -> tuple[float, int]:
            return self._meter.judge(*self._see(replace(base, sensors=(*base.sensors, each)))[:3])

        (ap, problems), better = judge(sensor), True
        while better:
            better = False
            for turn, down in TRIED:
                other = replace(sensor, heading=sensor.heading + turn, tilt=sensor.tilt + down)
                found, more = (
                    judge(other) if TILT_SPAN[0] <= other.tilt <= TILT_SPAN[1] else (ap, problems)
                )
                if found > ap + 1e-4 and more <= problems:
                    sensor = other
                    ap = found
                    problems = more
                    better = True
        answer = self.estimate(replace(base, sensors=(*base.sensors, sensor)))
        return Suggestion(kind, sensor, answer, self._stock.known)


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


def _describe_question(asked: Setting) -> dict[str, object]:
    cases = asked.cases
    most = None if math.isinf(asked.most_price) else asked.most_price
    said = {"classes": [*asked.counted.names], "iou": [*cases.ious], "errors": [*cases.names]}
    return {**said, "scheme": asked.fusion.name, "most_price": most}


def _finite(name: str, value: float) -> float:
    if not np.isfinite(value):
        raise ValueError(f"{name} must be a finite number, got {value}")
    return float(value)


def _check_tilt(tilt: float) -> float:
    if not abs(_finite("tilt", tilt)) <= np.pi / 2 + 1e-9:
        raise ValueError(
            f"a tilt must lie within pi/2 rad of the horizon, got {tilt:g}: give degrees as "
            "np.deg2rad(25)"
        )
    return float(tilt)


def _without(variant: Variant, name: str) -> Variant:
    return replace(variant, sensors=tuple(each for each in variant.sensors if each.name != name))


def _look(live: LiveView, every: Candidates, k: int, sensor: Sensor) -> bool:
    """Look from where a sensor hangs on the mount of candidate k; False where that is known."""
    if live.knows(sensor):
        return False
    live.see(replace(every.select([k]), sensors=(sensor,)), reach="own")
    return True
