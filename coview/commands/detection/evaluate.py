"""`coview evaluate`: score fusion schemes and sensor sets on a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from coview.arguments import (
    Label,
    check_errors,
    check_ious,
    check_least,
    check_positive,
    check_schemes,
    refuse_given,
    sensor_set,
    site_file,
)
from coview.clouds import score_clouds
from coview.detectors import recording_detector
from coview.exits import OK
from coview.outputs import check_folder
from coview.printing import print_result
from coview.progress_bar import progress_bar
from coview.recordings import frame_count, open_recording


def evaluate(
    dataset: Positional[Path],
    /,
    *,
    detector: str | None = None,
    layout: str | None = None,
    level: Literal["map", "plane", "none"] = "map",
    still: bool = False,
    area: tuple[float, float, float, float] | None = None,
    schemes: tuple[str, ...] | None = None,
    sensors: tuple[str, ...] = ("all",),
    classes: tuple[Label, ...] | None = None,
    iou: tuple[float, ...] | None = None,
    metric: Literal["3d", "bev"] = "3d",
    protocol: Literal["exact", "published"] = "exact",
    radius: float | None = None,
    codec: str = "paper",
    step: float = 0.02,
    refers_to: Literal["previous", "key"] = "previous",
    key_every: int = 10,
    rate: float | None = None,
    calibrate: str | None = None,
    frames: int | None = None,
    errors: str = "paper",
    seed: int = 0,
    site: str | None = None,
    drop_invalid: bool = False,
    out: Path = Path("out/evaluation"),
    overwrite: bool = False,
    json: bool = False,
) -> int:
    """Score fusion schemes and sensor sets on a recording: the paper's first table, as text, JSON and PR curves, and
    what the detector's threshold is worth class by class.

    Example: coview evaluate tjunction.hdf5 --schemes early late --sensors 0,2,5 all --iou 0.7 0.8

    Example: coview evaluate my-log --layout argoverse --detector general

    Example: coview evaluate my-junction --layout folder --schemes early late foreground --calibrate together --still

    Args:
        dataset: Recording made by coview simulate, or one of the authors' files; with --layout, of clouds.
        detector: cluster, general with --layout; a trained network: voxelnet for the site's own, a name, or a
            weights file; or your own, package.module:callable, either the detector or what makes it for a site (see
            toolkit.detection.imported). With +background behind it (voxelnet+background), what stands in the empty site
            is left out.
        layout: Of a recording of clouds, as in coview detect; then AP by footprint and volume, by range and points, in
            our protocol, KITTI's and nuScenes', is printed.
        level: With --layout, as in coview detect.
        still: With --layout, as in coview detect.
        area: With --layout, as in coview detect.
        schemes: Which of early, late, hybrid, foreground and differences (of foregrounds), the first
            three when left out; with --layout, all clouds at once.
        sensors: Sensor sets, each a comma-separated list of numbers or names, or all.
        classes: Classes to score; all that the detector says it knows when left out, vehicle where it does not say.
        iou: IoU thresholds; when left out 0.7 0.8 0.9 for vehicle and heavy, 0.25 0.5 0.7 for cyclist and pedestrian.
        metric: IoU of volumes or of footprints.
        protocol: exact, or the published code's own way of counting.
        radius: Hybrid fusion shares points farther than this from their sensor (m); the paper's value when left out.
        codec: Of what is sent: paper counts 96 bits a point and 256 a box, range-images sends bytes. The foreground
            scheme always sends bytes.
        step: In which bytes say distances (m): 0.02, 0.04, 0.08.
        refers_to: What differences are taken from: the previous message, or the last whole image (key), where messages
            may be lost. Frames must be close together (coview simulate --every 0.1).
        key_every: Messages from one whole image to the next at most, where differences are sent.
        rate: Frames per second (Hz): print what each scheme puts on a link.
        calibrate: With --layout, first find where the sensors are: by a reference as in coview calibrate, or together,
            by each other.
        frames: Only the first so many frames.
        errors: Of the sensors: paper (their own noise), surveyed, typical or poor; see toolkit.sensors.error_profiles.
        seed: Of the sensors' noise and errors.
        site: Name or file; needed for foreign recordings that show no built-in site.
        drop_invalid: Leave objects out that cannot be (NaN, no size, kilometres away), and say how many.
        out: Folder for table.json and the PR curves.
        overwrite: Replace the table and curves of another run.
        json: Print rows and class figures, with the reliability diagram of the scores, as JSON.
    """
    from toolkit.detection.evaluation import (
        curve_files,
        evaluate_dataset,
        format_class_table,
        format_table,
        save_evaluation,
    )
    from toolkit.detection.link.load import format_loads
    from toolkit.detection.link.range_images import find_codec
    from toolkit.detection.schemes import schemes_in_steps
    from toolkit.objects import check_known, known_labels
    from toolkit.points import select_sensors

    check_ious(iou or ())
    check_schemes(schemes or ())
    check_errors(errors)
    check_least("--radius", radius, 0.0)
    check_positive("--rate", rate)
    check_least("--key-every", key_every, 1)
    sent_by, named = (
        find_codec(codec, step=step),
        schemes_in_steps(step, refers_to=refers_to, key_every=key_every),
    )
    if layout is not None:
        others = {"--metric": metric != "3d", "--protocol": protocol != "exact", "--radius": radius is not None,
                  "--errors": errors != "paper", "--site": site is not None}  # fmt: skip
        refuse_given(others, "is not for --layout")
        check_folder(out, holds="table.json", inputs=[dataset], overwrite=overwrite)
        figures = score_clouds(
            dataset, layout, detector or "general", schemes=[named[name] for name in schemes or ()], codec=sent_by,
            sensors=sensors, classes=classes, iou=iou, level=level, still=still, area=area, frames=frames, rate=rate,
            calibrate=calibrate, hidden=json,
        )  # fmt: skip
        figures.save(out / "table.json")
        print_result(figures.as_dict(), f"{figures.text()}\nwritten to {out}/table.json", as_json=json)
        return OK
    refuse_given({"--level": level != "map", "--still": still, "--area": area is not None,
                  "--calibrate": calibrate is not None}, "needs --layout")  # fmt: skip
    schemes, detector = schemes or ("early", "late", "hybrid"), detector or "cluster"
    sets = [sensor_set(chosen) for chosen in sensors]
    with open_recording(dataset, site, drop_invalid=drop_invalid) as recording:
        total = frame_count(recording, frames)
        for chosen in sets:
            select_sensors(recording.sensors, chosen)
        compared = [named[name] for name in schemes]
        for name in ("table.json", *curve_files(classes or ("vehicle",), iou)):
            check_folder(out, holds=name, inputs=[dataset, *site_file(site)], overwrite=overwrite)
        detect = recording_detector(detector, recording)
        labels = classes or known_labels(detect) or ("vehicle",)
        check_known(detect, labels)
        for name in curve_files(labels, iou):
            check_folder(out, holds=name, inputs=[dataset, *site_file(site)], overwrite=overwrite)
        with progress_bar("frame", total, hidden=json) as bar:
            rows = evaluate_dataset(
                recording, detect, schemes=compared, codec=sent_by, rate=rate,
                classes=labels, iou_thresholds=iou, frames=total,
                sensor_sets=sets, noise_seed=seed, errors=errors, radius=radius, protocol=protocol, metric=metric,
                progress=bar.to,
            )  # fmt: skip
    save_evaluation(rows, out)
    load = f"\n\non a link at {rate:g} Hz:\n{format_loads(rows.loads)}" if rate is not None else ""
    tables = f"{format_table(rows)}{load}\n\nabove the detector's threshold:\n{format_class_table(rows.classes)}"
    print_result(rows.as_dict(), f"{tables}\nwritten to {out}/table.json, PR curves beside it", as_json=json)
    return OK
