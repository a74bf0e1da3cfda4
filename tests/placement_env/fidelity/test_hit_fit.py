"""A fit finds the model that made the hits, and refuses what it cannot be fitted to."""

from dataclasses import replace

import numpy as np
import pytest

from placement_env.fidelity.hit_fit import Observed, fit
from placement_env.fidelity.surrogate import Evidence, Surrogate
from placement_env.subsets import MemberSums
from toolkit.detection.schemes import find_scheme

SETS = np.random.default_rng(1).random((60, 12)) < 0.35


@pytest.fixture(scope="module")
def visibility(made_visibility):
    return made_visibility()


def test_fit_finds_the_model_that_made_the_hits_and_bulk(made_visibility, hit_model):
    sets = SETS[:30]
    seen = made_visibility(12, 250, seed=5)
    surrogate = Surrogate(seen, "early", hit_model)
    probability = np.stack([surrogate.hits(row)[0] for row in sets])
    hits = np.random.default_rng(6).random(probability.shape) < probability
    found = fit(
        [Observed(seen, sets, hits, surrogate(sets).ap)], scheme="early", iou=0.7, source="test"
    )
    estimate, truth = Surrogate(seen, "early", found)(sets), surrogate(sets)
    np.testing.assert_allclose(estimate.recall, truth.recall, atol=0.03)
    np.testing.assert_allclose(estimate.ap, truth.ap, atol=0.03)
    assert found.norm == pytest.approx(hit_model.norm, abs=0.4)
    assert found.density == pytest.approx(hit_model.density, rel=0.3)
    assert found.oblique == pytest.approx(hit_model.oblique, abs=0.3)
    model = replace(hit_model, bulk=0.7)
    sites = [made(made_visibility, model, seed) for seed in (7, 8)]
    found = fit(sites, scheme="early", iou=0.7)
    assert found.bulk == pytest.approx(0.7, abs=0.15)
    for site in sites:
        np.testing.assert_allclose(
            Surrogate(site.visibility, "early", found)(site.subsets).ap, site.ap, atol=0.03
        )


def test_fit_refuses_other_frames_and_certainty(visibility):
    with pytest.raises(ValueError, match="same frames"):
        fit(
            [Observed(visibility, SETS, np.zeros((60, 5), bool), np.zeros(60))],
            scheme="early",
            iou=0.7,
        )
    with pytest.raises(ValueError, match="hits and misses"):
        fit(
            [Observed(visibility, SETS, np.zeros((60, 300), bool), np.zeros(60))],
            scheme="early",
            iou=0.7,
        )


def made(made_visibility, model, seed, *, sets=SETS[:20], objects=160):
    """What a model hits at a site made up from the seed."""
    seen = made_visibility(12, objects, seed=seed)
    if model.bulk:
        seen.boxes[::3, 3:6] = 6.0, 2.1, 2.6
    evidence = Evidence(seen, find_scheme("early"), 20.0)
    p = model.probability(
        *evidence.joined(MemberSums(evidence.rows(model, np.float64))(sets), model)
    )
    p *= model.of_size(seen.boxes)
    hits = np.random.default_rng(seed + 50).random(p.shape) < p
    return Observed(
        seen, sets, hits, Surrogate(seen, "early", model)(sets).ap, 20.0, ("DepthCamera",)
    )


@pytest.mark.slow
def test_fit_finds_the_floor_and_says_how_sure_it_is_and_to_what_it_was_fitted(
    made_visibility, hit_model
):
    """Of two sites; where few points are few however dense they are."""
    model = replace(hit_model, intercept=-0.5, density=1.0, floor=25.0)
    sites = [made(made_visibility, model, seed) for seed in (7, 8)]
    found = fit(sites, scheme="early", iou=0.7, resamples=3, seed=5)
    assert found.floor == pytest.approx(25.0, rel=0.35)
    for site in sites:
        estimate = Surrogate(site.visibility, "early", found)(site.subsets)
        np.testing.assert_allclose(estimate.ap, site.ap, atol=0.03)
    domain = found.domain
    assert (domain.sites, domain.objects, domain.sets, domain.sensors) == (
        2,
        320,
        40,
        ("DepthCamera",),
    )
    points = np.concatenate([site.visibility.points[site.visibility.points > 0] for site in sites])
    assert domain.most_points == pytest.approx(np.quantile(points, 0.99), rel=0.01)
    assert len(found.resampled) == 3
    assert len(set(found.resampled)) == 3
    drawn = [
        Surrogate(sites[0].visibility, "early", each)(SETS[:20]).ap for each in found.resamples
    ]
    assert 0 < found.error < 0.3
    found = replace(found, error=0.0)
    spread = Surrogate(sites[0].visibility, "early", found).spread(SETS[:20])
    assert spread == pytest.approx(np.std(drawn, axis=0, ddof=1), abs=1e-6)
    sure = replace(found, error=0.1)
    ap = Surrogate(sites[0].visibility, "early", sure)(SETS[:20]).ap
    more = Surrogate(sites[0].visibility, "early", sure).spread(SETS[:20])
    assert more == pytest.approx(np.hypot(spread, 0.1 * np.sqrt(ap * (1 - ap))), abs=1e-6)
    assert 0 < spread.max() < 0.1
    assert (
        fit(sites, scheme="early", iou=0.7, resamples=1, seed=5).resampled[0] == found.resampled[0]
    )
