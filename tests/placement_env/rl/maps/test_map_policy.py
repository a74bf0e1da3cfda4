import json
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
import torch

from placement_env.candidates.drawing import with_mounts
from placement_env.candidates.outlook.outlook import outlook
from placement_env.envs.maps.terms import Terms
from placement_env.objective import Weights
from placement_env.rl.maps import map_policy
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


def test_a_file_has_the_same_bytes_in_every_process(policy, tmp_path):
    """Its header is sorted: the library would order it anew in each."""
    policy.save(tmp_path / "policy.safetensors")
    content = (tmp_path / "policy.safetensors").read_bytes()
    header = content[8 : 8 + int.from_bytes(content[:8], "little")].decode()
    assert header.rstrip() == json.dumps(json.loads(header), sort_keys=True, separators=(",", ":"))


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


def test_what_is_sent_is_asked_of_the_answer_alone_and_once(policy, junction, known):
    terms, asked = wide(junction), []
    refused = policy.answer_to(known, terms).members[:1]

    def sends(members):
        asked.append(members)
        return np.array([1e10 if member in refused else 1.0 for member in members])

    answer = policy.answer_checked(known, terms, sends)
    assert len(asked) == 2
    assert asked[0] == policy.answer_to(known, terms).members
    assert set(asked[1]) == set(answer.members) - set(asked[0])
    assert not set(refused) & set(answer.members)
    assert policy.answer_checked(known, terms, lambda members: np.full(len(members), 1e10)).members == ()


def test_known_kbit_are_within_the_link_or_not(policy, junction, known):
    """By the network the links carry the sensors with a chance of about a half; then it is known."""
    guess = np.exp(policy.predicted(known).log_kbit.astype(float))
    narrow = with_mounts(junction.candidates, [1.0] * 4, [300.0, 600.0, 900.0, 1200.0], [0.0])
    sent = np.where(np.arange(12) % 3 == 0, np.nan, narrow.capacity + np.tile([0.0, 0.0, 1e-3], 4))
    predicted = replace(policy.predicted(known), sent=sent)
    carried = predicted.carried(narrow)
    assert carried[1::3].tolist() == [1.0] * 4
    assert carried[2::3].tolist() == [0.0] * 4
    assert carried[0::3].tolist() == policy.predicted(known).carried(narrow)[0::3].tolist()
    assert predicted.kbit[1::3].tolist() == [300.0, 600.0, 900.0, 1200.0]
    spread = np.exp(2 * predicted.log_spread[0::3].astype(float)) / 2
    assert predicted.kbit[0::3] == pytest.approx(guess[0::3] * np.exp(spread), rel=1e-5)


def several(junction, places: int, link: float, price: float = 1.0):
    """Candidates whose mounts carry so many sensors over a link, each at half the price of a mount."""
    priced = with_mounts(junction.candidates, [price] * 4, [link] * 4, [price / 2])
    return replace(priced, mounts=tuple(replace(mount, max_sensors=places) for mount in priced.mounts))


@pytest.mark.parametrize("places", [1, 2, 3])
def test_a_pole_carries_as_many_as_it_says(policy, junction, known, places):
    some = several(junction, places, 1e9)
    terms = Terms.plain(some, 12)
    count = np.bincount(some.mount[list(policy.answer_to(known, terms).members)], minlength=4)
    assert count.max() == places
    pairs = {
        pair: policy.predicted(known).ap_of(pair)
        for pair in combinations(range(12), 2)
        if places > 1 or some.mount[pair[0]] != some.mount[pair[1]]
    }
    best = policy.answer_to(known, Terms.plain(some, 2), swaps=6)
    for gone in best.members:  # no other beside one of the two is better
        assert max(ap for pair, ap in pairs.items() if gone in pair) <= best.ap + 1e-6


def test_sensors_on_a_pole_share_its_link(policy, junction, known):
    sent = np.full(12, 100.0)
    for link, places in ((99.0, 0), (199.0, 1), (200.0, 2), (299.0, 2), (300.0, 3)):
        some = several(junction, 3, link)
        answer = policy.answer_to(known, Terms.plain(some, 12), sent=sent)
        assert np.bincount(some.mount[list(answer.members)], minlength=4).max() == places, link
        checked = policy.answer_checked(known, Terms.plain(some, 12), lambda members: sent[list(members)])
        assert np.bincount(some.mount[list(checked.members)], minlength=4).max() <= places, link
    first = int(np.flatnonzero(some.mount == 0)[0])
    guessed = policy.predicted(known)
    alone, beside = guessed.carried(some), guessed.carried(some, [first])
    assert (beside[some.mount == 0] < alone[some.mount == 0]).all()
    assert (beside[some.mount != 0] == alone[some.mount != 0]).all()


def test_a_pole_is_paid_once(policy, junction, known):
    some = several(junction, 3, 1e9, price=2.0)  # a pole costs 2 and a sensor 1
    for money, most in ((2.9, 0), (3.0, 1), (4.0, 2), (5.0, 3), (6.9, 3)):
        terms = Terms.plain(some, 12, most_price=money)
        answer = policy.answer_to(known, terms, swaps=0)
        assert terms.price(answer.members) <= money
        assert len(answer.members) <= most
        assert (len(answer.members) > 0) == (most > 0)
    gains = policy.predicted(known).gains([0], Terms.plain(some, 2, weights=Weights(price=0.01)))
    free = policy.predicted(known).gains([0], Terms.plain(some, 2))
    assert free - gains == pytest.approx(np.where(some.mount == some.mount[0], 0.01, 0.03), abs=1e-6)


def test_many_candidates_are_looked_at_in_parts(policy, known, monkeypatch):
    whole = policy.predicted(known)
    monkeypatch.setattr(map_policy, "PREDICTED_AT_ONCE", 5)
    parts = policy.predicted(known)
    for name in ("evidence", "weight", "log_kbit", "log_spread"):
        assert getattr(parts, name) == pytest.approx(getattr(whole, name), rel=1e-5)


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
