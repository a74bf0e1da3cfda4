"""Empirical Bayes, beside a simulation in which the truth is known."""

import numpy as np
import pytest

from placement_env.analysis.shrinkage import shrink

PREDICTED = np.array([0.80, 0.70, 0.75, 0.60])


def test_noise_counts_for_nothing_and_it_picks_better():
    figure = PREDICTED + 0.1 + np.array([0.01, -0.02, 0.03, -0.02])
    assert shrink(
        figure, np.repeat(figure[:, None], 50, axis=1), PREDICTED
    ).figure == pytest.approx(figure)
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
    noise = (
        np.random.default_rng(3).standard_normal((sets, 2000))
        * np.array([[0.01], [0.02], [0.03], [0.04]])[:sets]
    )
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
    assert shrink(figure, same, PREDICTED, blocks=1.0).figure == pytest.approx(
        PREDICTED - (PREDICTED - figure).mean()
    )
    assert shrink(figure, same, PREDICTED).figure == pytest.approx(figure)
    all_found = shrink(np.ones(4), np.ones((4, 9)), PREDICTED, blocks=3.0).figure
    assert np.argsort(all_found).tolist() == np.argsort(PREDICTED).tolist()
    assert shrink(figure[:2], same[:2], PREDICTED[:2], blocks=1.0).figure == pytest.approx(
        figure[:2]
    )
    undefined = np.array([0.9, np.nan, 0.5])
    assert shrink(undefined, same[:3], PREDICTED[:3]).figure == pytest.approx(
        undefined, nan_ok=True
    )


@pytest.mark.parametrize(("perfect", "blocks"), [(True, 4.0), (False, 12.0), (False, 3.0)])
def test_what_few_draws_do_not_show_is_added_exactly(perfect, blocks):
    """Where all draws agree, their spread is that of the least noise, times the root of the
    weight."""
    figure = np.ones(4) if perfect else PREDICTED + np.array([0.3, 0.0, 0.1, -0.1])
    found = shrink(figure, np.repeat(figure[:, None], 9, axis=1), PREDICTED, blocks=blocks)
    variance, off = 0.05**2 / blocks, figure - PREDICTED
    spread = max(0.02**2, off.var(ddof=1) - variance)
    weight = spread / (spread + variance)
    assert found.figure == pytest.approx(
        PREDICTED + off.mean() + weight * (off - off.mean()), abs=1e-12
    )
    assert found.resamples.mean(axis=1) == pytest.approx(found.figure, abs=1e-12)
    assert found.resamples.std(axis=1) == pytest.approx(
        np.full(4, np.sqrt(weight * variance)), abs=1e-12
    )
    drawn = np.random.default_rng(0).standard_normal((4, 9))  # the same every time
    assert np.corrcoef(found.resamples[2], drawn[2])[0, 1] == pytest.approx(1.0)


@pytest.mark.parametrize("blocks", [np.inf, 20.0])
def test_draws_off_the_figures_are_centred_and_shared_noise_stays(blocks):
    """Sets whose draws lie beside their figures, as resampled APs do, keep the figures; of the
    common noise nothing is shrunk."""
    rng = np.random.default_rng(4)
    own, shared = 0.02 * rng.standard_normal((4, 400)), 0.1 * rng.standard_normal(400)
    figure = PREDICTED + np.array([0.03, -0.02, 0.01, -0.01])
    plain = shrink(figure, figure[:, None] + own, PREDICTED, blocks)
    moved = shrink(
        figure,
        figure[:, None] + own + shared + np.array([[0.3], [-0.2], [0.1], [0.0]]),
        PREDICTED,
        blocks,
    )
    assert moved.figure == pytest.approx(plain.figure, abs=1e-12)
    assert moved.resamples == pytest.approx(plain.resamples + shared - shared.mean(), abs=1e-12)
    assert moved.resamples.mean(axis=1) == pytest.approx(plain.figure, abs=1e-12)
    if np.isinf(blocks):
        noise = own - own.mean(axis=0)
        noise -= noise.mean(axis=1, keepdims=True)
        variance = noise.var(axis=1)
        spread = max(0.02**2, (figure - PREDICTED).var(ddof=1) - variance.mean())
        weight = np.sqrt(spread / (spread + variance))[:, None]
        common = own.mean(axis=0) - own.mean()
        assert plain.resamples == pytest.approx(
            plain.figure[:, None] + weight * noise + common, abs=1e-12
        )


def test_predictions_are_trusted_to_two_hundredths_at_most():
    """Figures that lie where they were predicted, but for noise: the least error of a prediction
    counts."""
    noise = np.array([0.02, -0.02] * 50)
    figure = PREDICTED + np.array([0.01, -0.01, 0.0, 0.0])
    signs = np.array([[1.0], [-1.0], [1.0], [-1.0]])
    found = shrink(figure, figure[:, None] + signs * noise, PREDICTED)
    assert found.figure == pytest.approx(
        PREDICTED + 0.5 * (figure - PREDICTED)
    )  # 0.02² / (0.02² + 0.02²)
