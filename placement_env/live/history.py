"""`VariantHistory`: the variants of a plan by name, and the steps that can be undone."""

from collections.abc import Iterable
from typing import Any

from placement_env.live.variant import Variant, check_name

MAX_UNDO_STEPS = 2000  # that can be undone
Step = tuple[str, Variant]  # name of a variant, and as it was


class VariantHistory:
    """Variants by name, the one that is shown, and steps to undo and to redo.

    A copy shares nothing that changes. Threads that change it must hold a lock.

    Attributes:
        variants: Variants by name, in the order in which they were made.
        current: Name of the variant that is shown.
    """

    def __init__(self, start: Variant) -> None:
        self.variants: dict[str, Variant] = {"A": start}
        self.current = "A"
        self._past: list[Step] = []
        self._future: list[Step] = []
        self._dragged: str | None = None

    def __getstate__(self) -> dict[str, Any]:
        copied = {
            "variants": self.variants.copy(),
            "_past": self._past.copy(),
            "_future": self._future.copy(),
        }
        return self.__dict__ | copied

    @property
    def variant(self) -> Variant:
        """The variant that is shown."""
        return self.variants[self.current]

    @property
    def past(self) -> tuple[Step, ...]:
        """Steps that can be undone, the last one last."""
        return tuple(self._past)

    @property
    def future(self) -> tuple[Step, ...]:
        """Steps that can be done again, the last one undone last."""
        return tuple(self._future)

    def is_dragged(self, name: str) -> bool:
        """True if the last change was a step of a drag of this sensor."""
        return self._dragged == name

    def drag(self, name: str) -> None:
        """Let the next move of a sensor in a drag be part of the last step."""
        self._dragged = name

    def end_drag(self) -> None:
        """End a drag: the next change is a separate step."""
        self._dragged = None

    def change(self, variant: Variant, *, continues_drag: bool = False) -> bool:
        """Show a variant in place of the present one; True if that is a new step to undo."""
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
        if not source:
            raise ValueError(f"there is nothing to {what}")
        name, variant = source.pop()
        target.append((name, self.variants.get(name, variant)))
        self.variants[name] = variant
        self.current = name
        self._dragged = None

    def check_name(self, name: str, *, copy: bool) -> None:
        """Raise ValueError for an unknown variant; copy: for a taken name."""
        if copy == (check_name(name) in self.variants):
            names = ", ".join(self.variants)
            raise ValueError(
                f"{name!r} is {'taken' if copy else 'unknown'}: the variants are {names}"
            )

    def show(self, name: str, *, copy: bool) -> None:
        """Show a variant; copy: a new one, like the present. Raises ValueError as `check_name`."""
        self.check_name(name, copy=copy)
        if copy:
            self.variants[name] = self.variant
        self.current = name
        self._dragged = None

    def restore(self, variants: dict[str, Variant], current: str, past: Iterable[Step]) -> None:
        """Replace all variants and steps."""
        self.variants = dict(variants)
        self.current = current
        self._past = list(past)
        self._future = []
        self._dragged = None
