"""Fit the shipped surrogates: to what a detector hits with a site's own sensors and with poses of its pool.

    python tests/benchmarks/placement_env/fit_surrogate.py tjunction [--detector tjunction] [--frames 100] [--poses 60]
        [--sets 60] [--seed 1000] [--memo FILE] [--out placement_env/fidelity/surrogates/tjunction.json]

The traffic's seed must be another than that of what the surrogate is judged by. With a memo it goes on where it was
stopped. Prints each model and its Spearman correlation with the detector's AP on the sets it was fitted to.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[3]))


def sets_of(candidates, own: int, poses: int, count: int, rng: np.random.Generator) -> np.ndarray:
    """Random sets (n, own + poses), half of the site's own sensors, if any, half of 1 to 8 poses, one to a mount."""
    sets, of_own = np.zeros((count, own + poses), bool), count // 2 if own else 0
    for row in sets[:of_own]:
        row[rng.choice(own, rng.integers(1, own + 1), replace=False)] = True
    for row in sets[of_own:]:
        members = own + rng.permutation(poses)
        _, first = np.unique(candidates.mount[members], return_index=True)
        row[members[np.sort(first)][: rng.integers(1, 9)]] = True
    return np.unique(sets, axis=0)


def together(site, poses: int, rng: np.random.Generator):
    """The site's own sensors and, after them, some random poses of its pool."""
    from dataclasses import replace

    from placement_env.candidates.pool import paper_candidates, pool

    own, more = paper_candidates(site), pool(site)
    more = more.select(np.sort(rng.choice(len(more), poses, replace=False)))
    mount = np.concatenate([own.mount, len(own.mounts) + more.mount])
    return replace(
        own,
        sensors=(*own.sensors, *more.sensors),
        mounts=(*own.mounts, *more.mounts),
        mount=mount,
        factors=np.column_stack([mount, np.zeros((len(mount), 4), np.int64)]),
    )


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("site")
    arguments.add_argument("--detector")
    arguments.add_argument("--memo", type=Path)
    arguments.add_argument("--out", type=Path)
    for name, default in (("frames", 100), ("poses", 60), ("sets", 60), ("seed", 1000)):
        arguments.add_argument(f"--{name}", type=int, default=default)
    asked = arguments.parse_args()
    asked.detector = asked.detector or asked.site

    from scipy.stats import spearmanr

    from models.detector import load_detector
    from placement_env.fidelity.detector import Detected
    from placement_env.fidelity.hit_fit import fit_detected
    from placement_env.fidelity.hit_model import FOLDER, save_models
    from placement_env.fidelity.renders import Renders
    from placement_env.fidelity.surrogate import Surrogate
    from placement_env.fidelity.traffic import simulate_traffic
    from placement_env.fidelity.visibility import see
    from toolkit.detection.schemes import PAPER_SCHEMES
    from toolkit.sites.files import load_site

    rng = np.random.default_rng(asked.seed)
    site = load_site(asked.site)
    candidates = together(site, asked.poses, rng)
    sets = sets_of(candidates, len(site.sensors), asked.poses, asked.sets, rng)
    frames = simulate_traffic(site, asked.frames, asked.seed)
    visibility, renders = see(frames, candidates), Renders(frames, candidates)
    source = (
        f"{asked.frames} frames of {asked.site} traffic, seed {asked.seed}, {len(sets)} sets, detector {asked.detector}"
    )
    detector, models = load_detector(asked.detector, area=site.area), []
    for scheme in PAPER_SCHEMES:
        detected = Detected(renders, detector, scheme, memo=asked.memo)
        for model in fit_detected(visibility, detected, sets, radius=site.hybrid_radius, source=source):
            ap = detected.estimates(sets)[model.iou].ap
            rho = spearmanr(Surrogate(visibility, scheme, model)(sets).ap, ap).statistic
            print(model, f"Spearman {rho:.3f}", flush=True)
            models.append(model)
    save_models(tuple(models), asked.out or FOLDER / f"{asked.detector}.json")


if __name__ == "__main__":
    main()
