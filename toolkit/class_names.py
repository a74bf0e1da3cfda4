"""Names that data sets give to road users, and the class that each counts as."""

from collections.abc import Iterable
from difflib import get_close_matches

from toolkit.objects import LABELS, label_index
from toolkit.runtime.text_values import read_own_table

_TABLE = read_own_table(__file__, "classes.toml")
CATEGORIES = {
    category: label_index(label) for label, categories in _TABLE.items() for category in categories
}


def check_classes(names: Iterable[str]) -> None:
    """Raise ValueError for a name that is no class, with the class that it counts as.

    >>> check_classes(["Car"])
    Traceback (most recent call last):
    ValueError: there is no class 'Car', it counts as vehicle: choose among vehicle, cyclist,
        pedestrian, heavy
    """
    for name in names:
        if name not in LABELS:
            raise ValueError(
                f"there is no class {name!r}{_hint(name)}: choose among {', '.join(LABELS)}"
            )


def _hint(name: str) -> str:
    """Hint for an unknown class name, to go into an error: the class that it may mean, or ""."""
    category = name.strip().lower().replace(" ", "")
    matches = get_close_matches(category, [*LABELS, *CATEGORIES], n=1, cutoff=0.75)
    # the name itself, its singular, and the most similar known name
    for candidate in (category, category.removesuffix("s"), *matches):
        if candidate in LABELS:
            return f", but {candidate}"
        if candidate in CATEGORIES:
            return f", it counts as {LABELS[CATEGORIES[candidate]]}"
    return ""
