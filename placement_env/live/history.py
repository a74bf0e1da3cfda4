"""`VariantHistory`: the variants of a plan by name, and the steps that can be undone."""

from collections.abc import Iterable
from typing import Any

from placement_env.live.variant import Variant, check_name

MAX_UNDO_STEPS = 2000  # steps that can be undone; older ones are forgotten
Step = tuple[str, Variant]  # name of a variant, and its state before the step


class VariantHistory:
    """Variants by name, the one that is shown, and steps to undo and to redo.

    A copy shares nothing that changes. Threads that change it must hold a lock. start: first
    variant, which is named A.

    Attributes:
        variants: Variants by name, in the order in which they were made.
        current: Name of the variant that is shown.
    """

    def __init__(self, start: Variant) -> None:
        """Begin with one variant, named A."""
        self.variants: dict[str, Variant] = {"A": start}
        self.current = "A"
        self._past: list[Step] = []
        self._future: list[Step] = []
        self._dragged: str | None = None

    def __getstate__(self) -> dict[str, Any]:
        """Fields to pickle, with copies of those that other threads change."""
        copies = {
            "variants": self.variants.copy(),
            "_past": self._past.copy(),
            "_future": self._future.copy(),
        }
        return self.__dict__ | copies

    @property
    def variant(self) -> Variant:
        """The variant that is shown."""
        return self.variants[self.current]

    @property
    def past_steps(self) -> tuple[Step, ...]:
        """Steps that can be undone, the latest one last."""
        return tuple(self._past)

    @property
    def future(self) -> tuple[Step, ...]:
        """Steps that can be done again, the one undone latest last."""
        return tuple(self._future)

    def is_dragged(self, name: str) -> bool:
        """True if the last change was a step of a drag of the sensor with this name."""
        return self._dragged == name

    def drag(self, name: str) -> None:
        """Let the next move of the named sensor in a drag be part of the last step."""
        self._dragged = name

    def end_drag(self) -> None:
        """End a drag: the next change is a separate step."""
        self._dragged = None

    def change(self, variant: Variant, *, continues_drag: bool = False) -> bool:
        """Replace the variant that is shown; return True if that is a new step to undo.

        continues_drag: True if the last step already keeps the state before the drag. Any change
        empties the steps to redo and ends a drag."""
        is_changed = variant != self.variant
        is_step = is_changed and not continues_drag
        if is_step:
            self._past.append((self.current, self.variant))
            del self._past[:-MAX_UNDO_STEPS]
        if is_changed:
            self._future.clear()
        self.variants[self.current] = variant
        self._dragged = None
        return is_step

    def undo(self) -> None:
        """Undo the last change. Raises ValueError without one."""
        self._step(self._past, self._future, "undo")

    def redo(self) -> None:
        """Redo the last change that was undone. Raises ValueError without one."""
        self._step(self._future, self._past, "redo")

    def _step(self, source: list[Step], target: list[Step], what: str) -> None:
        """Take the last step of `source`, and keep the present state in `target`.

        Both lists change. what: "undo" or "redo", for the error."""
        if not source:
            raise ValueError(f"there is nothing to {what}")
        name, variant = source.pop()
        target.append((name, self.variants.get(name, variant)))
        self.variants[name] = variant
        self.current = name
        self._dragged = None

    def check_name(self, name: str, *, copy: bool) -> None:
        """Raise ValueError for the name of no variant, or, with copy, for a name that is taken."""
        # both sides are bools: a new name must be free, another one must exist
        if copy == (check_name(name) in self.variants):
            names = ", ".join(self.variants)
            raise ValueError(
                f"{name!r} is {'taken' if copy else 'unknown'}: the variants are {names}"
            )

    def show(self, name: str, *, copy: bool) -> None:
        """Show the named variant, or, with copy, a new one that is like the present.

        Raises ValueError for the name of no variant, or, with copy, for a name that is taken."""
        self.check_name(name, copy=copy)
        if copy:
            self.variants[name] = self.variant
        self.current = name
        self._dragged = None

    def restore(self, variants: dict[str, Variant], current: str, past: Iterable[Step]) -> None:
        """Replace all variants and steps by saved ones, without anything to redo.

        current: name of the variant to show; past: steps to undo, the latest one last."""
        self.variants = dict(variants)
        self.current = current
        self._past = list(past)
        self._future = []
        self._dragged = None
