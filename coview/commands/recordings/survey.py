"""`coview survey`: count what a recording holds."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from coview.arguments import Label, check_errors, sensor_set
from coview.exits import OK
from coview.printing import print_result
from coview.progress_bar import progress_bar
from coview.recordings import frame_count, open_recording


def survey(
    dataset: Positional[Path],
    /,
    *,
    sensors: tuple[str, ...] = ("all",),
    classes: tuple[Label, ...] = ("vehicle", "cyclist", "pedestrian", "heavy"),
    frames: int | None = None,
    errors: str = "paper",
    seed: int = 0,
    site: str | None = None,
    drop_invalid: bool = False,
    json: bool = False,
) -> int:
    """Count what a recording holds: objects per frame, kbit of early fusion, points on the objects of each class.

    Example: coview survey tjunction.hdf5 --sensors 4 3,4 0,2,5 all

    Args:
        dataset: Recording.
        sensors: Sensor sets, as in coview evaluate.
        classes: Whose points are counted.
        frames: Only the first so many frames.
        errors: As in coview evaluate.
        seed: Of the sensors' noise and errors.
        site: As in coview evaluate.
        drop_invalid: As in coview evaluate.
        json: Print as JSON.
    """
    from toolkit.detection.survey import survey as count
    from toolkit.points import select_sensors

    check_errors(errors)
    with open_recording(dataset, site, drop_invalid=drop_invalid) as recording:
        total = frame_count(recording, frames)
        sets = [select_sensors(recording.sensors, sensor_set(chosen)) for chosen in sensors]
        with progress_bar("frame", total, hidden=json) as bar:
            counted = count(recording, classes=classes, frames=total, noise_seed=seed, errors=errors, progress=bar.to)
    figures = counted.as_dict(sets)
    objects = "  ".join(f"{name} {number:.2f}" for name, number in figures["objects_per_frame"].items())
    lines = [f"objects per frame in the area: {objects}", f"early fusion: {figures['kbit_per_sensor']:.0f} kbit/sensor"]
    for label, of_class in figures["classes"].items():
        for chosen, each in of_class["sets"].items() if of_class["objects"] else ():
            lines.append(
                f"{label} from {chosen}: {each['unseen']:.1%} of {of_class['objects']} without a point, "
                f"mean {each['mean_points']:.1f}, median {each['median_points']:g} points"
            )
    print_result(figures, "\n".join(lines), as_json=json)
    return OK
