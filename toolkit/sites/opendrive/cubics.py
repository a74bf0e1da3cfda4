"""Numbers and cubic polynomials of OpenDRIVE elements: widths, borders and heights.

A polynomial is valid from its start to the next one's (ASAM OpenDRIVE 1.8, 7.3 and 11.6). Errors of
damaged numbers do not name the file: their caller does."""

from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from toolkit.arrays import Float, Float64
from toolkit.geometry import MAX_COORDINATE_M


@dataclass(frozen=True, eq=False)
class Cubics:
    """Piecewise cubic function of s, 0 without rows.

    Row i is a + b ds + c ds² + d ds³ from s = starts[i] on."""

    starts: Float64[np.ndarray, " n"]
    rows: Float64[np.ndarray, "n 4"]

    def at(self, s: Float[np.ndarray, " k"]) -> Float64[np.ndarray, " k"]:
        """Values of the function at `s`; before the first piece, the value at its start."""
        if not len(self.starts):
            return np.zeros(len(s))
        # index of the piece that is valid at each s
        piece = np.clip(np.searchsorted(self.starts, s, side="right") - 1, 0, None)
        ds = np.maximum(s - self.starts[piece], 0.0)
        powers = ds[:, None] ** np.arange(4)  # columns 1, ds, ds², ds³
        return np.sum(self.rows[piece] * powers, axis=1)

    def slope(self, s: Float[np.ndarray, " k"]) -> Float64[np.ndarray, " k"]:
        """Derivatives of the function at `s`; the first piece's at its start holds before it."""
        derivatives = self.rows[:, 1:] * [1, 2, 3]  # b + 2 c ds + 3 d ds²
        rows = np.column_stack([derivatives, np.zeros(len(self.rows))])
        return Cubics(self.starts, rows).at(s)

    def cut_start(self, s: float) -> "Cubics":
        """Return the function with `s` as its new zero, without the pieces that end before it."""
        return self.split([s, *self.starts[self.starts > s].tolist()]).move(-s)

    def move(self, by: float) -> "Cubics":
        """Return the function moved by `by` along s."""
        return Cubics(self.starts + by, self.rows)

    def split(self, starts: Sequence[float]) -> "Cubics":
        """Return the function with pieces that begin at other places: `starts`, ascending.

        They must include all starts of the function's pieces from the first new start on. The
        values remain the same from there on."""
        if not len(self.starts):
            return Cubics(np.array(starts, np.float64), np.zeros((len(starts), 4)))
        rows = np.array([self._find_row(s) for s in starts]).reshape(-1, 4)
        return Cubics(np.array(starts, np.float64), rows)

    def subtract(self, other: "Cubics") -> "Cubics":
        """Difference of this function and another, with the starts of both and 0."""
        starts = sorted({0.0, *self.starts.tolist(), *other.starts.tolist()})
        return Cubics(np.array(starts), self.split(starts).rows - other.split(starts).rows)

    def negate(self) -> "Cubics":
        """Function of the opposite sign."""
        return Cubics(self.starts, -self.rows)

    def _find_row(self, s: float) -> Float64[np.ndarray, "4"]:
        """Coefficients of the piece that is valid at `s`, as a cubic in the distance from `s`.

        They are a, b, c, d of a + b x + c x² + d x³ with x = 0 at `s`. Before the first piece, the
        function is constant."""
        piece = max(int(np.searchsorted(self.starts, s, side="right")) - 1, 0)
        ds = s - self.starts[piece]
        a, b, c, d = self.rows[piece]
        if ds < 0:
            return np.array([a, 0.0, 0.0, 0.0])
        if ds == 0:
            return self.rows[piece]
        value = a + b * ds + c * ds**2 + d * ds**3
        slope = b + 2 * c * ds + 3 * d * ds**2
        return np.array([value, slope, c + 3 * d * ds, d])


def read_number(element: ElementTree.Element, key: str, default: float | None = None) -> float:
    """Read an attribute of an element as a finite number within `MAX_COORDINATE_M`.

    default: number for a missing attribute, which is an error if None. Raises ValueError, which
    names element and attribute but not the file."""
    text = element.get(key)
    if text is None and default is not None:
        return default
    try:
        value = float(text or "")
    except ValueError:
        value = np.nan
    if not abs(value) <= MAX_COORDINATE_M:
        raise ValueError(
            f"<{element.tag}> needs a finite number as {key}, got {str(text)[:30]!r}: export it "
            "again"
        )
    return value


def read_cubics(elements: list[ElementTree.Element], key: str = "s") -> Cubics:
    """Read the piecewise function of elements with a, b, c, d, each valid from its start on.

    key: attribute of the start, by which the pieces are sorted; of equal starts the last element
    counts. No elements give the function 0."""
    names = (key, "a", "b", "c", "d")
    numbers = [read_number(element, name, 0.0) for element in elements for name in names]
    table = np.array(numbers, np.float64).reshape(-1, 5)
    if len(table) > 1:
        starts = table[:, 0]
        table = table[np.argsort(starts, kind="stable")]  # the last of equal starts remains last
    return Cubics(starts=table[:, 0], rows=table[:, 1:])
