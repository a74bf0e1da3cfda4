import numpy as np
import pytest
import torch

from placement_env.rl.maps import imitation
from placement_env.rl.maps.imitation import IMITATION, Teaching, imitate, losses_of, total_loss
from placement_env.rl.maps.lessons import lesson_of
from placement_env.rl.maps.map_network import MapNetwork


@pytest.fixture(scope="module")
def lessons(made_up):
    return [lesson_of(made_up(seed, 4, 3), seed) for seed in range(2)]


def same(one: MapNetwork, two: MapNetwork) -> bool:
    return all(torch.equal(a, b) for a, b in zip(one.state_dict().values(), two.state_dict().values(), strict=True))


def test_it_learns_what_sets_are_worth(lessons, tmp_path):
    told = []
    teaching = Teaching(passes=12, width=8)
    network = imitate(lessons, tmp_path, teaching=teaching, progress=lambda done, losses: told.append((done, losses)))
    assert [done for done, _ in told] == list(range(1, 13))
    first, last = told[0][1], told[-1][1]
    assert set(first) == {"hit", "crowd", "kbit", "ap", "regret"}
    assert last["ap"] < 0.9 * first["ap"]
    assert last["hit"] < first["hit"]
    assert last["regret"] < first["regret"]
    total = total_loss(losses_of(network, lessons[0]), Teaching(of_ap=2.0, of_regret=3.0))
    each = losses_of(network, lessons[0])
    summed = each["hit"] + each["crowd"] + each["kbit"] + 2 * each["ap"] + 3 * each["regret"]
    assert total.item() == pytest.approx(summed.item())
    assert {name: float(loss.detach()) for name, loss in losses_of(network, lessons[0]).items()}["ap"] < first["ap"]


def test_stopped_and_continued_is_the_same(lessons, tmp_path):
    teaching = Teaching(passes=4, width=8)

    def stop(done: int, losses: dict[str, float]) -> None:
        if done == 2:
            raise KeyboardInterrupt

    whole = imitate(lessons, tmp_path / "whole", teaching=teaching, seed=3)
    with pytest.raises(KeyboardInterrupt):
        imitate(lessons, tmp_path / "parts", teaching=teaching, seed=3, progress=stop)
    later = []
    parts = imitate(lessons, tmp_path / "parts", teaching=teaching, seed=3, progress=lambda n, _: later.append(n))
    assert later == [3, 4]
    assert same(whole, parts)
    assert not same(whole, imitate(lessons, tmp_path / "other", teaching=teaching, seed=4))


def test_it_goes_on_within_a_pass(lessons, tmp_path, monkeypatch):
    """Killed after the third of four steps, whose checkpoint was written."""
    teaching, every = Teaching(passes=2, width=8), {"every_s": 0.0}
    whole, told = imitate(lessons, tmp_path / "whole", teaching=teaching, **every), []
    steps = []

    def dying(network, lesson):
        steps.append(lesson)
        if len(steps) == 4:
            raise KeyboardInterrupt
        return losses_of(network, lesson)

    monkeypatch.setattr(imitation, "losses_of", dying)
    with pytest.raises(KeyboardInterrupt):
        imitate(lessons, tmp_path / "parts", teaching=teaching, **every)
    assert steps[3] is not steps[2]  # every lesson once in a pass
    parts = imitate(lessons, tmp_path / "parts", teaching=teaching, **every, progress=lambda *pass_: told.append(pass_))
    assert len(steps) == 5
    assert same(whole, parts)
    assert [done for done, _ in told] == [2]
    monkeypatch.undo()
    fresh = []
    imitate(lessons, tmp_path / "third", teaching=teaching, progress=lambda *pass_: fresh.append(pass_))
    assert told == fresh[1:]  # the mean over the whole pass


def test_losses_of_a_perfect_guess(lessons):
    """Regret is nothing where the best is sure to be chosen, and what a uniform choice loses where all look alike."""
    network, lesson = MapNetwork(8), lessons[0]
    with torch.no_grad():
        network.out.weight.zero_()
        network.out.bias.fill_(-20.0)  # nobody sees anything: all candidates look alike
    losses = losses_of(network, lesson)
    best = np.nanmax(lesson.ap, axis=1, keepdims=True)
    assert float(losses["regret"]) == pytest.approx(np.nanmean(best - lesson.ap, axis=1).mean(), rel=1e-3)
    hit = network.hit(torch.tensor(np.exp(-20.0))).item()
    expected = -(lesson.alone * np.log(hit + 1e-6) + (1 - lesson.alone) * np.log(1 - hit))
    assert float(losses["hit"]) == pytest.approx(float(expected.mean()), rel=0.05)


def test_errors(lessons, tmp_path):
    imitate(lessons, tmp_path, teaching=Teaching(passes=1, width=8))
    with pytest.raises(ValueError, match="is of other lessons: choose another folder"):
        imitate(lessons[:1], tmp_path, teaching=Teaching(passes=1, width=8))
    with pytest.raises(ValueError, match="is of other lessons"):  # as many, but other ones
        imitate([lessons[0], lessons[0]], tmp_path, teaching=Teaching(passes=1, width=8))
    with pytest.raises(ValueError, match="is of other teaching and seed"):
        imitate(lessons, tmp_path, teaching=Teaching(passes=2, width=8), seed=1)
    (tmp_path / IMITATION).write_bytes(b"damaged")
    with pytest.raises(ValueError, match="remove it to begin anew"):
        imitate(lessons, tmp_path, teaching=Teaching(passes=1, width=8))
    with pytest.raises(ValueError, match="got none"):
        imitate([], tmp_path)
    with pytest.raises(ValueError, match="passes must be a whole number"):
        imitate(lessons, tmp_path, teaching=Teaching(passes=0))
