"""Problems of recordings, counted by kind while they are read."""

Problems = dict[str, int]  # number of labels and points left out, by kind
NOT_FINITE = "labels with NaN or infinite numbers"
NO_SIZE = "boxes of no size"
TOO_LARGE = "boxes too large or too far away to be"
OTHER_KINDS = "labels of other kinds than ours"
STRAY = "names, times or tokens of labels have no cloud"
UNLABELLED = "frames without labels among labelled ones, whose objects are unknown"
DOUBLED = "doubled labels"
DOUBLED_CLOUDS = "clouds that are there under another ending too, left out"
FULL_TURNS = "yaws beyond a full turn"
TILTED = "boxes tilted by more than 20 degrees, of which only the heading is kept"
NOT_FINITE_POINTS = "points with NaN or infinite numbers"
NO_RETURN_POINTS = "points of no return"
FAR_POINTS = "points a kilometre from the middle of their cloud"
EMPTY = "clouds without points"
UNPLACED = "clouds far from their sensor's origin: the sensor counts as in their middle"
COARSE_POINTS = "clouds in float32 so far from their origin that it holds no centimetres"
UNTIMED = "clouds whose points have times of an unknown unit, which were left out"


def add_problem(problems: Problems, kind: str, number: int) -> None:
    """Add a number to the count of a kind of problem; `problems` changes, but not for 0."""
    if number:
        problems[kind] = problems.get(kind, 0) + number
