"""`coview survey`: count what a recording holds."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from coview.arguments import Label, check_errors, sensor_set
from coview.outputs import OK, print_result
from coview.progress_bar import progress_bar
from coview.recordings import Opening, frame_count


def survey(
    dataset: Positional[Path],
    /,
    *,
    sensors: tuple[str, ...] = ("all",),
    classes: tuple[Label, ...] = ("vehicle", "cyclist", "pedestrian", "heavy"),
    frames: int | None = None,
    errors: str = "paper",
    seed: int = 0,
    json: bool = False,
    opening: Opening = Opening(),
) -> int:
    """Count what a recording holds: objects per frame, kbit of early fusion, points on the objects of each class.

    Counted is the site's area where that is known, else all that is there.

    Example: coview survey tjunction.hdf5 --sensors 4 3,4 0,2,5 all

    Example: coview survey my-log --layout argoverse

    Args:
        dataset: Recording in any layout.
        sensors: Sensor sets, as in coview evaluate.
        classes: Classes whose points are counted.
        frames: Number of first frames to use; all when left out.
        errors: Error profile, as in coview evaluate.
        seed: Seed of the sensors' noise and errors.
        json: Print as JSON.
    """
    from toolkit.datasets.readings import Reads
    from toolkit.detection.survey import survey as count
    from toolkit.frame import select_sensors

    check_errors(errors)
    with opening.open(dataset) as recording:
        total = frame_count(recording, frames)
        if not total:
            raise ValueError("there is no frame to survey: check the path and the layout")
        chosen = [select_sensors(recording[0].sensors, sensor_set(each)) for each in sensors]
        with progress_bar("frame", total, hidden=json) as bar:
            counted = count(recording, classes=classes, reads=Reads(errors, seed, total), progress=bar.to)
    print_result(counted.as_dict(chosen), counted.text(chosen), as_json=json)
    return OK
