"""`VariantEditor`: sensors on poles that are changed by hand, each change answered by figures."""

from collections.abc import Callable, Iterable
from copy import copy as copied
from threading import RLock
from typing import Any

from placement_env.live.changes import (
    DEFAULT_TILT_RAD,
    VariantChange,
    duplicate_sensor,
    fail_sensor,
    keep_out_of,
    lock_sensor,
    mount_sensor,
    move_sensor,
    remove_sensor,
)
from placement_env.live.figures import LiveAnswer
from placement_env.live.history import Step, VariantHistory
from placement_env.live.picture import GroundPicture
from placement_env.live.scorer import LiveScorer
from placement_env.live.suggestions import Suggestion, apply_suggestion
from placement_env.live.variant import Corners, LiveSensor, PoleOrSpot, Variant, Yard


class VariantEditor:
    """Variants that are changed by hand, with undo.

    A copy, also a pickled one, has the same variants, views and steps to undo. Its changes do not
    reach the original, and nobody listens to them.

    Attributes:
        yard: Site and stock that variants are made of.
        scorer: Figures of variants by the surrogate.
        history: Variants by name, the one that is shown, and steps to undo.
        picture: Picture under the scene, or None.
    """

    def __init__(self, yard: Yard, scorer: LiveScorer) -> None:
        """Begin with one variant: the sensors that the site has."""
        self.yard = yard
        self.scorer = scorer
        self.history = VariantHistory(yard.place(yard.site.sensors))
        self.picture: GroundPicture | None = None
        self._reset_lock_and_listener()

    def _reset_lock_and_listener(self) -> None:
        """Begin with a free lock and without a listener, as neither is copied."""
        self._lock = RLock()
        self._notify: Callable[[bool], None] = _notify_nobody

    def __getstate__(self) -> dict[str, Any]:
        """Fields to pickle, without locks and listener."""
        # the locks keep other threads from changing anything meanwhile
        with self.scorer.all_frames.fetching, self._lock:
            state = dict(self.__dict__)
        for name in ("_lock", "_notify"):  # made again by `_reset_lock_and_listener`
            del state[name]
        for name in ("scorer", "history"):
            state[name] = copied(state[name])
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._reset_lock_and_listener()

    def listen(self, notify: Callable[[bool], None]) -> None:
        """Call a function after every change, before its answer; it replaces the one before.

        notify: called with True if the change is a further move of a drag, else with False."""
        self._notify = notify

    # what is shown

    @property
    def variants(self) -> dict[str, Variant]:
        """Variants by name, in the order in which they were made."""
        return self.history.variants

    @property
    def current(self) -> str:
        """Name of the variant that is shown."""
        return self.history.current

    @property
    def variant(self) -> Variant:
        """The variant that is shown."""
        return self.history.variant

    @property
    def sensors(self) -> tuple[LiveSensor, ...]:
        """Sensors of the variant that is shown."""
        return self.variant.sensors

    @property
    def past_steps(self) -> tuple[Step, ...]:
        """Steps that can be undone, the latest one last."""
        return self.history.past_steps

    # changes

    def move(
        self,
        name: str,
        heading: float | None = None,
        tilt: float | None = None,
        height: float | None = None,
        position: PoleOrSpot | None = None,
        *,
        dragging: bool = False,
    ) -> LiveAnswer:
        """Turn, tilt, raise or carry a sensor, and return the figures of the variant.

        Heights stay within the range of the pole, tilts within `TILT_SPAN_RAD`. Heading, tilt,
        height and position are None to keep the present one.

        Args:
            name: Name of the sensor.
            heading: Heading, counter-clockwise from the site's +x (rad).
            tilt: Tilt below the horizon (rad).
            height: Height above the foot of the pole (m).
            position: Name of a pole, or x and y of a place (m).
            dragging: True for a move that is undone together with the moves of this sensor before
                it.

        Raises:
            ValueError: For an unknown or locked sensor, a tilt beyond straight down, and a place
                that no pole may use.
        """
        with self._lock:
            change = move_sensor(
                self.yard,
                self.variant,
                name,
                heading=heading,
                tilt=tilt,
                height=height,
                position=position,
            )
            continues_drag = dragging and self.history.is_dragged(name)
            answer = self._show_change(change, continues_drag=continues_drag)
            if dragging:
                self.history.drag(name)
            return answer

    def add(
        self,
        mount: PoleOrSpot,
        heading: float = 0.0,
        tilt: float = DEFAULT_TILT_RAD,
        height: float | None = None,
        *,
        model: str | None = None,
        name: str | None = None,
    ) -> LiveAnswer:
        """Add a sensor, and return the figures of the variant with it.

        mount: name of a pole, or x and y (m) of a place; heading: counter-clockwise from the site's
        +x (rad); tilt: below the horizon (rad); height: above the foot of the pole (m), None for
        the highest; model: name of a model in the stock, None for the first; name: name of the
        sensor, None for an unused one. Raises ValueError for a place that no pole may use, a pole
        without room, an unknown model, and a name that is taken."""
        return self._apply(
            mount_sensor, mount, heading=heading, tilt=tilt, height=height, model=model, name=name
        )

    def remove(self, name: str) -> LiveAnswer:
        """Remove a sensor, and return the figures without it.

        Raises ValueError for an unknown or locked one."""
        return self._apply(remove_sensor, name)

    def duplicate(self, name: str) -> LiveAnswer:
        """Mount a copy of a sensor on the nearest pole with room, and return the new figures.

        Raises ValueError for an unknown sensor, and if no pole has room."""
        return self._apply(duplicate_sensor, name)

    def lock(self, name: str, locked: bool = True) -> LiveAnswer:
        """Keep a sensor from being moved, or, with locked=False, let it be moved again.

        Raises ValueError for an unknown one."""
        return self._apply(lock_sensor, name, locked)

    def fail(self, name: str, failed: bool = True) -> LiveAnswer:
        """Let a sensor fail, or, with failed=False, work again, and return the new figures.

        A failed sensor is mounted, but sees and sends nothing. Raises ValueError for an unknown
        one."""
        return self._apply(fail_sensor, name, failed)

    def set_keep_out(self, areas: Iterable[Corners]) -> LiveAnswer:
        """Keep poles out of areas, which replace all that the variant had.

        areas: corners (x, y in m) of each. Raises ValueError for corners that form no area."""
        return self._apply(keep_out_of, areas)

    def accept(self, suggestion: Suggestion) -> LiveAnswer:
        """Make a suggested change, and return the new figures.

        Raises ValueError if the variant has changed so that the suggestion does not fit."""
        return self._apply(apply_suggestion, suggestion)

    def _apply(
        self, change: Callable[..., VariantChange], *arguments: Any, **options: Any
    ) -> LiveAnswer:
        """Change the shown variant, and return the new figures.

        change: function of `placement_env.live.changes`, which gets the yard (site and poses to
        choose from), the variant and the further arguments."""
        with self._lock:
            return self._show_change(change(self.yard, self.variant, *arguments, **options))

    def _show_change(self, change: VariantChange, *, continues_drag: bool = False) -> LiveAnswer:
        """Show the variant after a change, and return its figures.

        Additional poles that carry no sensor are left out. continues_drag: True if the change is
        undone together with the last step. The caller holds the lock."""
        before = self.scorer.recall(self.variant)
        variant = change.variant.without_idle_poles()
        is_new_step = self.history.change(variant, continues_drag=continues_drag)
        if is_new_step:  # during a drag, changes are since its start
            self.scorer.compare_with(before)
        self._notify(continues_drag)
        return self.answer(change.what)

    def end_drag(self) -> None:
        """End a drag: the next move is a separate step."""
        self.history.end_drag()
        self._notify(False)  # no move of a drag

    def lay(self, picture: GroundPicture | None) -> None:
        """Lay a picture under the scene; None removes it."""
        self.picture = picture
        self._notify(False)  # no move of a drag

    # steps and variants

    def undo(self) -> LiveAnswer:
        """Undo the last change. Raises ValueError without one."""
        return self._step(self.history.undo, "undo")

    def redo(self) -> LiveAnswer:
        """Redo the last change that was undone. Raises ValueError without one."""
        return self._step(self.history.redo, "redo")

    def _step(self, step: Callable[[], None], what: str) -> LiveAnswer:
        """Undo or redo, and return the figures with the change that it makes.

        step: `history.undo` or `history.redo`; what: words for it."""
        with self._lock:
            before = self.scorer.recall(self.variant)
            step()
            self.scorer.compare_with(before)
            self._notify(False)  # no move of a drag
            return self.answer(what)

    def show(self, name: str, *, copy: bool = False) -> LiveAnswer:
        """Show the named variant, or, with copy, a new one that is like the present.

        Raises ValueError for the name of no variant, or, with copy, for a name that is taken."""
        with self._lock:
            self.history.check_name(name, copy=copy)
            before = self.answer()
            self.history.show(name, copy=copy)
            self.scorer.compare_with(before)
            self._notify(False)  # no move of a drag
            return self.answer(f"variant {name}")

    def restore(self, variants: dict[str, Variant], current: str, past: Iterable[Step]) -> None:
        """Replace variants and steps by saved ones.

        current: name of the variant to show; past: steps to undo, the latest one last. Raises
        ValueError if they do not fit the site and stock."""
        steps = list(past)
        past_variants = [variant for _, variant in steps]
        for variant in (*variants.values(), *past_variants):
            self.yard.check(variant)
        if current not in variants:
            raise ValueError(f"the shown variant {current!r} must be one of {', '.join(variants)}")
        with self._lock:
            self.history.restore(variants, current, steps)
            self.scorer.compare_with(None)

    def answer(self, what: str = "") -> LiveAnswer:
        """Figures of the variant that is shown, and their change since those before.

        what: words for what led to the variant, "" without a change."""
        with self._lock:
            return self.scorer.answer(self.variant, what)

    def estimate(self, variant: Variant) -> LiveAnswer:
        """Figures of any variant, shown or not, without a change since others."""
        with self._lock:
            return self.scorer.estimate(variant)


def _notify_nobody(dragging: bool) -> None:
    pass
