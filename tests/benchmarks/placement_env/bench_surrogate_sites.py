"""How far a surrogate's AP is from the detector's at sites that it was not fitted to, and whether
it says so.

    python tests/benchmarks/placement_env/bench_surrogate_sites.py SITE.json ... [--frames 8]
        [--sets 16] [--seed 9301] [--scheme early] [--model MODELS.json] [--cache out/cache]

Sets of 1 to 8 of the site's own sensors and 60 random poses with cameras and lidars, as a fit draws
them; the detector is general with the empty site known. Printed for each model: root mean square
and mean of predicted less measured AP, the standard error stated, and the shares of sets within one
and within two of it (68 and 95 % if it is true).
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[3]))

MODELS = ("depth-camera", "spinning-lidar", "solid-state-lidar")


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("sites", nargs="+")
    arguments.add_argument("--frames", type=int, default=8)
    arguments.add_argument("--sets", type=int, default=16)
    arguments.add_argument("--seed", type=int, default=9301)
    arguments.add_argument("--scheme", default="early")
    arguments.add_argument("--model", type=Path, help="general's own when left out")
    arguments.add_argument("--cache", type=Path, default=Path("out/cache"))
    asked = arguments.parse_args()

    from coview.detector_spec import DetectorSpec
    from coview.detectors import open_detector
    from placement_env.classes import Classes
    from placement_env.fidelity.detector import Detected
    from placement_env.fidelity.hit_fit import Sampling
    from placement_env.fidelity.hit_model import SURROGATE_FOLDER, load_models
    from placement_env.fidelity.renders import Renders
    from placement_env.fidelity.seeing import see
    from placement_env.fidelity.surrogate import Surrogate
    from toolkit.runtime.run import Run
    from toolkit.sensors.models import find_model
    from toolkit.sites.files import load_site

    models = [
        m
        for m in load_models(asked.model or SURROGATE_FOLDER / "general.json")
        if m.scheme == asked.scheme
    ]
    classes = Classes(("vehicle", "cyclist", "pedestrian"))
    ious = sorted({m.iou for m in models if m.label == "vehicle"})
    rows: dict[tuple[str, float], list[np.ndarray]] = {}
    run = Run(cache=asked.cache)
    sampling = Sampling(poses=60, sets=asked.sets, models=tuple(map(find_model, MODELS)))
    for place, name in enumerate(asked.sites):
        site = load_site(name)
        traffic, candidates, sets = sampling.draw(site, asked.frames, asked.seed + place)
        seen = see(traffic, candidates, labels=classes.labels, run=run)
        renders = Renders(traffic, candidates, run.memo)
        detector = open_detector(DetectorSpec.from_name("general"), site)
        made = Detected(
            renders, detector, asked.scheme, memo=run.memo, processes=run, classes=classes
        )
        found = made.at(ious[0], also=ious).class_estimates(sets)
        for model in models:
            iou = model.iou if model.label == "vehicle" else ious[0]
            measured = found[iou].ap[:, classes.names.index(model.label)]
            of_class = Classes((model.label,))
            surrogate = Surrogate(
                seen, asked.scheme, model, radius=site.hybrid_radius, classes=of_class
            )
            row = np.stack([surrogate(sets).ap - measured, surrogate.spread(sets)])
            rows.setdefault((model.label, model.iou), []).append(row[:, np.isfinite(measured)])
        print(f"{name}: {len(sets)} sets", file=sys.stderr, flush=True)
    print(
        f"{'':10} {'IoU':>5} {'sets':>5} {'rms':>6} {'mean':>7} {'stated':>7} {'within 1':>9} "
        f"{'within 2':>9}"
    )
    for (label, iou), parts in rows.items():
        error, stated = np.concatenate(parts, axis=1)
        rms, said = (float(np.sqrt(np.square(each).mean())) for each in (error, stated))
        one, two = (float((np.abs(error) <= k * stated).mean()) for k in (1, 2))
        figures = f"{rms:6.3f} {error.mean():+7.3f} {said:7.3f} {one:9.2f} {two:9.2f}"
        print(f"{label:10} {iou:5g} {len(error):5} {figures}")


if __name__ == "__main__":
    main()
