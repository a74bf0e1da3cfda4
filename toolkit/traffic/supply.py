"""Bodies of traffic in random order of use, and SUMO's types for them."""

from collections.abc import Sequence
from itertools import count

import numpy as np

from toolkit.arrays import Int64, Rng
from toolkit.bodies.body import Body
from toolkit.objects import CYCLIST, HEAVY, PEDESTRIAN, VEHICLE

HEAVY_SHARE = 0.08  # share of heavy vehicles among the vehicles
# probability of each class among spawned objects, from the paper's section "Dataset"
SHARES = {VEHICLE: 0.6 * (1 - HEAVY_SHARE), HEAVY: 0.6 * HEAVY_SHARE, CYCLIST: 0.2, PEDESTRIAN: 0.2}
# standard deviation of an object's yaw from the path's (degrees)
SWAY_DEG = {VEHICLE: 0.5, HEAVY: 0.3, CYCLIST: 2.0, PEDESTRIAN: 8.0}
# standard deviation of an object's place from the middle of the lane (m)
LANE_OFFSETS_M = {VEHICLE: 0.25, HEAVY: 0.0, CYCLIST: 0.8, PEDESTRIAN: 0.0}
MAX_BICYCLE_LENGTH_M = 1.75  # m; a longer two-wheeler has an engine
POSITIONS = 3  # number of lateral positions in the lane that are drawn for each body


class Supply:
    """Bodies of traffic in random order of use, with SUMO's types for them and the next numbers of
    objects.

    A row is the number of a body in the given bodies.

    Attributes:
        rng: generator of all random numbers of the traffic.
        once: a body that was taken does not come again before all others offered with it have been
            taken too, so that in a large fleet each object has a different body.
        ids: counter that gives the id of the next object.
        labels: class number of each body.
        sizes: its length, width, height (m).
        classes: its SUMO class, which decides which lanes are open to it."""

    def __init__(self, bodies: Sequence[Body], rng: Rng, *, once: bool = False) -> None:
        """Find the SUMO class of each body, before any is taken."""
        self.rng = rng
        self.once = once  # True to use each body once before any comes again
        self.ids = count()  # ids for objects
        self._taken = np.zeros(len(bodies), bool)
        self.labels = np.array([body.label for body in bodies], np.int64)
        # length, width and height (m) of each body
        self.sizes = np.array([body.size for body in bodies], np.float64).reshape(-1, 3)
        # SUMO's vehicle class of each body; two-wheelers have one by their length
        class_by_label = {VEHICLE: "passenger", HEAVY: "truck", PEDESTRIAN: "pedestrian"}
        classes = []
        for body in bodies:
            length = body.size[0]
            two_wheeler = "bicycle" if length <= MAX_BICYCLE_LENGTH_M else "motorcycle"
            classes.append(class_by_label.get(body.label, two_wheeler))
        self.classes = tuple(classes)

    def sumo_types(self) -> str:
        """Text of SUMO's additional file with a type for each body and lateral position.

        A type's id is "row-position". Random numbers are drawn at each call."""
        elements = []
        for row, (label, (length, width, height)) in enumerate(
            zip(self.labels.tolist(), self.sizes, strict=True)
        ):
            for position in range(POSITIONS):
                # m from the lane's middle to the object, positive to the left
                offset = np.clip(self.rng.normal(0, LANE_OFFSETS_M[label]), -1.2, 1.2)
                # m from the object ahead to this one when both stand
                gap = self.rng.uniform(1.0, 2.5) if label != PEDESTRIAN else 0.5
                elements.append(
                    f'<vType id="{row}-{position}" vClass="{self.classes[row]}" '
                    f'length="{length:.3f}" width="{width:.3f}" height="{height:.3f}" '
                    f'minGap="{gap:.2f}" latAlignment="{offset:.2f}"/>'
                )
        return "<additional>\n" + "\n".join(elements) + "\n</additional>\n"

    def offer(self, rows: Int64[np.ndarray, " n"]) -> int:
        """Draw one of these rows of bodies; call `take` when it is used.

        With `once`, rows that are not used yet are drawn, and all again after the last of them."""
        if not self.once:
            return int(self.rng.choice(rows))
        unused_rows = rows[~self._taken[rows]]
        if not len(unused_rows):
            self._taken[rows] = False
            unused_rows = rows
        return int(self.rng.choice(unused_rows))

    def take(self, row: int, *, is_used: bool = True) -> None:
        """Note that the body of a row is used. is_used: False if it was not used after all."""
        self._taken[row] = is_used

    def several(self, rows: Int64[np.ndarray, " n"], number: int) -> Int64[np.ndarray, " m"]:
        """Draw `number` of these rows of bodies, with repeats if need be, and take them.

        With `once`, no row comes again before all others have been drawn."""
        drawn = [] if self.once else self.rng.choice(rows, number).tolist()
        while len(drawn) < number:
            drawn.append(self.offer(rows))
            self.take(drawn[-1])
        return np.array(drawn, np.int64)
