"""`coview survey`: count what a recording holds."""

from __future__ import annotations

from pathlib import Path

from tyro.conf import Positional

from coview.arguments import Label, check_errors, check_least, refuse_given, sensor_set
from coview.clouds import first_of, open_clouds, passing
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
    layout: str | None = None,
    json: bool = False,
) -> int:
    """Count what a recording holds: objects per frame, kbit of early fusion, points on the objects of each class.

    Example: coview survey tjunction.hdf5 --sensors 4 3,4 0,2,5 all

    Example: coview survey my-log --layout argoverse

    Args:
        dataset: Recording.
        sensors: Sensor sets, as in coview evaluate.
        classes: Whose points are counted.
        frames: Only the first so many frames.
        errors: As in coview evaluate.
        seed: Of the sensors' noise and errors.
        site: As in coview evaluate.
        drop_invalid: As in coview evaluate.
        layout: Of a recording of clouds, as in coview detect; then its labels and points are counted as they are.
        json: Print as JSON.
    """
    from toolkit.detection.survey import survey as count
    from toolkit.points import select_sensors

    check_errors(errors)
    if layout is not None:
        refuse_given({"--sensors": sensors != ("all",), "--site": site is not None, "--errors": errors != "paper"},
                     "is not for --layout")  # fmt: skip
        return _survey_clouds(dataset, layout, classes, frames, json)
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


def _survey_clouds(path: Path, layout: str, classes: tuple[Label, ...], frames: int | None, json: bool) -> int:
    from toolkit.detection.survey import survey_samples, survey_text

    check_least("--frames", frames, 1, "leave it out for all")
    samples = open_clouds(path, layout)
    with progress_bar("sample", min(len(samples), frames or len(samples)), hidden=json) as bar:
        figures = survey_samples(passing(first_of(samples, frames), {}, bar.to), classes=classes)
    print_result(figures, survey_text(figures), as_json=json)
    return OK
