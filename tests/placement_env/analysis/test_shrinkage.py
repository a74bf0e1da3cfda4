"""Empirical Bayes, beside a simulation in which the truth is known."""

import numpy as np
import pytest

from placement_env.analysis.shrinkage import shrink

PREDICTED = np.array([0.80, 0.70, 0.75, 0.60])


def test_noise_counts_for_nothing_and_it_picks_better():
    figure = PREDICTED + 0.1 + np.array([0.01, -0.02, 0.03, -0.02])
    assert shrink(figure, np.repeat(figure[:, None], 50, axis=1), PREDICTED).figure == pytest.approx(figure)
    noise = 5.0 * np.random.default_rng(0).standard_normal((4, 400))
    lost = shrink(figure, figure[:, None] + noise, PREDICTED)
    assert lost.figure == pytest.approx(PREDICTED + 0.1, abs=1e-5)
    assert np.argsort(lost.figure).tolist() == np.argsort(PREDICTED).tolist()
    draws = np.random.default_rng(0).standard_normal(300)
    figure = PREDICTED + np.array([0.0, 0.05, -0.05, 0.0])
    found = shrink(figure, figure[:, None] + draws, PREDICTED)
    assert found.figure == pytest.approx(figure)
    assert found.resamples.std(axis=1) == pytest.approx(np.repeat(draws.std(), 4))
    rng, errors, chosen, deviation = np.random.default_rng(5), [], [], 0.03
    for _ in range(300):
        truth = 0.8 + 0.04 * rng.standard_normal(8)
        predicted = truth - 0.1 + 0.03 * rng.standard_normal(8)
        figure = truth + deviation * rng.standard_normal(8)
        draws = figure[:, None] + deviation * rng.standard_normal((8, 200))
        shrunk = shrink(figure, draws, predicted, blocks=24.0).figure
        each = (figure, predicted + (figure - predicted).mean(), shrunk)
        errors.append([np.abs(one - truth).mean() for one in each])
        chosen.append([truth.max() - truth[one.argmax()] for one in each])
    assert np.mean(errors, axis=0)[2] < 0.85 * np.mean(errors, axis=0)[:2].min()
    assert np.mean(chosen, axis=0)[2] < 0.85 * np.mean(chosen, axis=0)[:2].min()


@pytest.mark.parametrize(("sets", "blocks"), [(4, 5.0), (3, 2.0)])
def test_weights_are_those_of_the_formula(sets, blocks):
    noise = np.random.default_rng(3).standard_normal((sets, 2000)) * np.array([[0.01], [0.02], [0.03], [0.04]])[:sets]
    noise -= noise.mean(axis=0)
    noise -= noise.mean(axis=1, keepdims=True)
    off, predicted = np.array([0.06, -0.02, 0.05, -0.01])[:sets], PREDICTED[:sets]
    own = noise.var(axis=1) * blocks / (blocks - 1)
    least = max(own.mean(), 0.05**2 / blocks)
    assert (own.mean() == least) == (sets == 4)
    variance = np.maximum(own, least)
    spread = off.var(ddof=1) - variance.mean()
    weight = spread / (spread + variance)
    found = shrink(predicted + off, (predicted + off)[:, None] + noise, predicted, blocks=blocks)
    assert found.figure == pytest.approx(predicted + off.mean() + weight * (off - off.mean()))
    assert found.resamples.mean(axis=1) == pytest.approx(found.figure)
    spreads = np.sqrt(weight * (noise.var(axis=1) + variance - own))
    assert found.resamples.std(axis=1) == pytest.approx(spreads, rel=0.05)


def test_lucky_blocks_are_no_surer_and_few_are_left():
    rng, blocks = np.random.default_rng(1), 12.0
    noise = 0.03 * rng.standard_normal((4, 500))
    noise[0] *= 0.1
    figure = PREDICTED + np.array([0.1, 0.0, 0.01, -0.01])
    found = shrink(figure, figure[:, None] + noise, PREDICTED, blocks=blocks)
    assert found.resamples.std(axis=1)[0] > 0.6 * found.resamples.std(axis=1)[1:].mean()
    assert found.figure[0] < shrink(figure, figure[:, None] + noise, PREDICTED).figure[0]
    perfect = shrink(np.ones(4), np.ones((4, 500)), PREDICTED, blocks=blocks)
    assert (perfect.resamples.std(axis=1) > 0.005).all()
    figure = np.array([0.9, 0.3, 0.5, 0.7])
    same = np.repeat(figure[:, None], 9, axis=1)
    assert shrink(figure, same, PREDICTED, blocks=1.0).figure == pytest.approx(PREDICTED - (PREDICTED - figure).mean())
    assert shrink(figure, same, PREDICTED).figure == pytest.approx(figure)
    all_found = shrink(np.ones(4), np.ones((4, 9)), PREDICTED, blocks=3.0).figure
    assert np.argsort(all_found).tolist() == np.argsort(PREDICTED).tolist()
    assert shrink(figure[:2], same[:2], PREDICTED[:2], blocks=1.0).figure == pytest.approx(figure[:2])
    undefined = np.array([0.9, np.nan, 0.5])
    assert shrink(undefined, same[:3], PREDICTED[:3]).figure == pytest.approx(undefined, nan_ok=True)
