import numpy as np
import pytest

pytest.importorskip("sb3_contrib")
import torch

from placement_env.envs.select import SensorSelectEnv
from placement_env.envs.state import GLOBAL
from placement_env.rl import training as learning
from placement_env.rl.learning import Learning
from placement_env.rl.policy_network import FEATURES, CandidateNetwork, distinct

SLOTS = 5


@pytest.fixture
def network():
    torch.manual_seed(0)
    network = CandidateNetwork(SLOTS, 8)
    torch.nn.init.normal_(network.place.weight)
    torch.nn.init.normal_(network.stop.weight)
    return network


def test_observations_in_any_order_are_judged_alike(network):
    rng = np.random.default_rng(1)
    features, whole = rng.normal(size=(3, FEATURES, SLOTS)), rng.normal(size=(3, len(GLOBAL)))
    order = rng.permutation(SLOTS)

    def logits(of_slots):
        rows = np.concatenate([of_slots.reshape(3, -1), whole], axis=1)
        return network(torch.tensor(rows, dtype=torch.float32))

    (place, value), (turned, same) = logits(features), logits(features[..., order])
    torch.testing.assert_close(place[:, :-1][:, order], turned[:, :-1])
    torch.testing.assert_close(place[:, -1], turned[:, -1])
    torch.testing.assert_close(value, same)
    observations = torch.randn(2, FEATURES * SLOTS + len(GLOBAL))
    actor, critic = network(observations)
    torch.testing.assert_close(network.forward_actor(observations), actor)
    torch.testing.assert_close(network.forward_critic(observations), critic)
    few = torch.randn(3, FEATURES * SLOTS + len(GLOBAL))
    again = torch.tensor([2, 0, 2, 2, 1, 0])
    rows, which = distinct(few[again])
    assert torch.equal(rows, few[[2, 0, 1]])
    assert torch.equal(rows[which], few[again])
    for several, alone in zip(network(few[again]), network(few), strict=True):
        torch.testing.assert_close(several, alone[again])
    equal, _ = CandidateNetwork(SLOTS, 8)(torch.randn(2, FEATURES * SLOTS + len(GLOBAL)))
    assert not equal.any()


def test_choosing_one_after_another_is_learnt_with_it_and_all_else_is_not(make, tmp_path):
    objective = make(5, 2)
    small = Learning(envs=2, rollout=32, batch=32, epochs=2, width=16)

    def network_of(actions: str) -> torch.nn.Module:
        def make_env() -> SensorSelectEnv:
            return SensorSelectEnv(objective=objective, budget=2, actions=actions)

        return learning.train_policy(
            make_env, tmp_path / actions, steps=64, learning=small
        ).policy.mlp_extractor

    assert isinstance(network_of("flat"), CandidateNetwork)
    assert not isinstance(network_of("factored"), CandidateNetwork)
