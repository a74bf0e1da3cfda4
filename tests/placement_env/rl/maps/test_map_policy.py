from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import torch

from placement_env.candidates.drawing import with_mounts
from placement_env.candidates.outlook.outlook import outlook
from placement_env.envs.maps.terms import Terms
from placement_env.objective import Weights
from placement_env.rl.maps.imitation import Teaching, imitate
from placement_env.rl.maps.lessons import lesson_of
from placement_env.rl.maps.map_network import MapNetwork
from placement_env.rl.maps.map_policy import MapPolicy


@pytest.fixture(scope="module")
def junction(made_up):
    return made_up(2, 4, 3)


@pytest.fixture(scope="module")
def policy(made_up, tmp_path_factory) -> MapPolicy:
    lessons = [lesson_of(made_up(seed, 4, 3), seed) for seed in range(2)]
    return MapPolicy(imitate(lessons, tmp_path_factory.mktemp("policy"), teaching=Teaching(passes=15, width=8)), "two")


@pytest.fixture(scope="module")
def known(junction):
    return outlook(junction.site, junction.candidates)


def wide(junction, budget: int = 2, **more) -> Terms:
    """Terms under which every link carries everything."""
    counts = [1.0] * len(junction.candidates.mounts), [1e9] * len(junction.candidates.mounts)
    priced = with_mounts(junction.candidates, *counts, [0.0] * len(junction.candidates.axes.models))
    return Terms(budget, priced, np.zeros(len(priced), np.bool_), **more)


def test_tabled_values_are_those_of_the_network(policy, known):
    predicted = policy.predicted(known)
    with torch.no_grad():
        channels = torch.from_numpy(known.plan.channels[known.plan.used])
        seen = policy.network.prospects(channels, torch.from_numpy(known.view), torch.from_numpy(known.features))
        chosen = torch.zeros(1, 12)
        chosen[0, 3] = 1
        expected = policy.network.next_ap(seen, chosen)[0].numpy()
    for c in range(12):
        if c != 3:
            assert predicted.ap_of([3, c]) == pytest.approx(float(expected[c]), abs=2e-3)
    assert predicted.ap_of([]) == 0


def test_the_answer_is_the_best_pair_that_is_predicted(policy, junction, known):
    terms, predicted = wide(junction), policy.predicted(known)
    answer = policy.answer_to(known, terms)
    mount = junction.candidates.mount
    pairs = {pair: predicted.ap_of(pair) for pair in combinations(range(12), 2) if mount[pair[0]] != mount[pair[1]]}
    assert answer.ap == pytest.approx(pairs[answer.members])
    for gone in answer.members:  # a local optimum, as swaps leave it
        others = [p for p in pairs if len({gone, *answer.members} & {*p}) >= 1 and set(answer.members) - {gone} <= {*p}]
        assert max(pairs[p] for p in others) <= answer.ap + 1e-6
    assert policy.answer_to(known, terms, swaps=0).ap <= answer.ap + 1e-6
    same = policy.answer(junction.site, junction.candidates, 2, terms=terms)
    assert same == answer


def test_terms_are_kept(policy, junction, known):
    free = policy.answer_to(known, wide(junction, 3))
    assert len(free.members) == 3
    failed = np.isin(np.arange(12), free.members)
    without = policy.answer_to(known, replace(wide(junction, 3), failed=failed))
    assert not set(without.members) & set(free.members)
    assert len(policy.answer_to(known, wide(junction, 3, most_price=2.0)).members) == 2
    assert policy.answer_to(known, wide(junction, 3, weights=Weights(price=5.0))).members == ()
    assert len(policy.answer_to(known, wide(junction, 9)).members) == 4  # a mount each


def test_a_link_counts_as_far_as_it_is_likely_to_carry(policy, junction, known):
    predicted, terms = policy.predicted(known), wide(junction)
    kbit = np.exp(predicted.log_kbit).astype(float)
    for share, low, high in ((1.0, 0.49, 0.51), (1e3, 0.99, 1.0), (1e-3, 0.0, 0.01)):
        links = [kbit[junction.candidates.mount == m].mean() * share for m in range(4)]
        narrow = with_mounts(junction.candidates, [1.0] * 4, links, [0.0])
        exact = [c for c in range(12) if abs(kbit[c] / narrow.capacity[c] * share - 1) < 1e-6 or share != 1.0]
        carried = predicted.carried(narrow)[exact]
        assert ((carried >= low) & (carried <= high)).all()
        assert predicted.gains([], replace(terms, candidates=narrow)) == pytest.approx(
            predicted.carried(narrow) * predicted.gains([], terms), rel=1e-6
        )


def test_links_are_asked_of_the_answer_alone(policy, junction, known):
    terms, asked = wide(junction), []
    refused = policy.answer_to(known, terms).members[:1]

    def carries(members):
        asked.append(members)
        return [member not in refused for member in members]

    answer = policy.answer_checked(known, terms, carries)
    assert len(asked) == 2
    assert asked[0] == policy.answer_to(known, terms).members
    assert asked[1] == answer.members
    assert not set(refused) & set(answer.members)
    assert policy.answer_checked(known, terms, lambda members: [False] * len(members)).members == ()


def test_kbit_counts_per_sensor(policy, junction, known):
    predicted, terms = policy.predicted(known), wide(junction, weights=Weights(comm=1e-4, price=0.01))
    kbit = np.exp(predicted.log_kbit.astype(float) + np.exp(2.0 * predicted.log_spread) / 2)
    before = predicted.ap_of([3]) - 1e-4 * kbit[3]
    after = predicted.ap_of([3, 7]) - 1e-4 * (kbit[3] + kbit[7]) / 2
    assert predicted.gains([3], terms)[7] == pytest.approx(after - before - 0.01, abs=1e-5)


def test_a_shortlist_has_the_answer_and_the_best_beside_it(policy, junction, known):
    terms = wide(junction)
    some = policy.shortlist(known, terms, 5)
    assert len(some) == 5
    assert (np.diff(some) > 0).all()
    assert set(policy.answer_to(known, terms, swaps=0).members) <= set(some.tolist())
    assert int(policy.predicted(known).gains([], terms).argmax()) in some
    assert policy.shortlist(known, terms, 99).tolist() == list(range(12))


def test_files(policy, junction, tmp_path):
    path = tmp_path / "policy.safetensors"
    policy.save(path)
    again = MapPolicy.load(path)
    assert again.source == "two"
    assert again.answer(junction.site, junction.candidates, 2) == policy.answer(junction.site, junction.candidates, 2)
    content = path.read_bytes()
    path.write_bytes(content[:-4] + b"abcd")
    with pytest.raises(ValueError, match="is damaged: its tensors are not those"):
        MapPolicy.load(path)
    path.write_bytes(content[:50])
    with pytest.raises(ValueError, match="is damaged or no safetensors file"):
        MapPolicy.load(path)
    with pytest.raises(FileNotFoundError, match="no policy at"):
        MapPolicy.load(tmp_path / "none")
    with pytest.raises(ValueError, match="not in the format"):
        MapPolicy.load("models/weights/tjunction.safetensors")
    broken = MapNetwork(8)
    with torch.no_grad():
        broken.out.bias.fill_(float("nan"))
    with pytest.raises(ValueError, match="not finite"):
        MapPolicy(broken).save(tmp_path / "broken")


def test_errors(policy, junction, known, made_up):
    with pytest.raises(ValueError, match="budget must be a whole number"):
        policy.answer(junction.site, junction.candidates, 0)
    with pytest.raises(ValueError, match="terms are of 6 candidates, the outlook of 12"):
        policy.answer_to(known, Terms.plain(made_up(0, 3, 2).candidates, 2))
