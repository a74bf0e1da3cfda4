from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch

from placement_env.envs.select import SensorSelectEnv
from placement_env.rl import training as learning
from placement_env.rl.learning import Learning
from placement_env.search.checkpoint import Checkpoint
from placement_env.search.checkpoint_folder import NOWHERE
from placement_env.search.exact import exhaustive
from placement_env.setting import Weights

pytest.importorskip("sb3_contrib")
SMALL = Learning(envs=2, rollout=32, batch=32, epochs=2, width=16)
VALUE = np.array([0.1, 0.2, 0.6, 0.3])


class PickEnv(gym.Env):
    """Pick two of four candidates, told apart by their value; nothing twice, within four turns."""

    observation_space = gym.spaces.Box(0.0, 1.0, (4,), np.float32)

    def __init__(self, masked=True):
        self.masked = masked
        self.action_space = (
            gym.spaces.Discrete(4) if masked else gym.spaces.Box(-1.0, 1.0, (4,), np.float32)
        )

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.chosen, self.turns = np.zeros(4, bool), 0
        return self.chosen.astype(np.float32), {}

    def action_masks(self):
        return ~self.chosen

    def step(self, action):
        before = VALUE[self.chosen].sum()
        self.turns += 1
        self.chosen[int(action if self.masked else np.argmax(action))] = True
        ap = float(VALUE[self.chosen].sum())
        terms = {"ap": ap, "comm": 0.0, "price": 0.0}
        figures = {"ap": ap, "recall": ap, "kbit": 1.0, "kbit_per_sensor": 1.0, "price": 1.0}
        info = {
            **figures,
            "reward_terms": terms,
            "subset": self.chosen.copy(),
            "fidelity": "toy",
            "cache_hit": False,
        }
        return (
            self.chosen.astype(np.float32),
            ap - before,
            bool(self.chosen.sum() >= 2),
            self.turns == 4,
            info,
        )


def weights(model):
    return torch.cat([p.detach().ravel() for p in model.policy.parameters()])


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole")
    return learning.train_policy(PickEnv, out, steps=768, learning=SMALL), out


def test_what_is_kept_is_loaded_and_another_run_is_refused(trained):
    model, _ = trained
    assert type(model).__name__ == "MaskablePPO"
    assert model.num_timesteps == 768
    model, out = trained
    assert torch.equal(
        weights(learning.train_policy(PickEnv, out, steps=1, learning=SMALL)), weights(model)
    )
    assert [path.name for path in out.iterdir()] == [learning.POLICY_FILE]
    _, out = trained
    with pytest.raises(ValueError, match="another seed"):
        learning.train_policy(PickEnv, out, steps=64, seed=1, learning=SMALL)


def test_what_was_stopped_goes_on_unless_cut_or_unknown(trained, tmp_path):
    model, _ = trained
    learning.train_policy(PickEnv, tmp_path, steps=256, learning=SMALL)
    again = learning.train_policy(PickEnv, tmp_path, steps=768, learning=SMALL)
    assert torch.equal(weights(model), weights(again))
    cut = tmp_path / learning.POLICY_FILE
    cut.write_bytes((trained[1] / learning.POLICY_FILE).read_bytes()[:1000])
    with pytest.raises(
        ValueError,
        match=r"policy.pt is damaged or not a checkpoint of tensors: .*: remove it to start again",
    ):
        learning.train_policy(PickEnv, tmp_path, steps=1, learning=SMALL)
    (tmp_path / learning.POLICY_FILE).write_bytes((trained[1] / learning.POLICY_FILE).read_bytes())
    rounds = [[512, {"best": 0.5}], [768, {"best": 0.7}], [1024, {"best": 0.9}]]
    assert learning.restore_rounds(tmp_path, rounds) == {"best": 0.7}
    assert [steps for steps, _ in rounds] == [512, 768]
    assert learning.restore_rounds(tmp_path, rounds[:1]) is None
    assert not (tmp_path / learning.POLICY_FILE).exists()


@pytest.mark.slow
def test_continuous_actions_get_ppo_which_learns_to_an_end(tmp_path):
    told = []
    quick = Learning(
        envs=4, rollout=64, batch=64, epochs=8, learning_rate=3e-3, entropy=0.0, width=16
    )
    policy = learning.train_policy(
        PickEnv,
        tmp_path,
        steps=2048,
        learning=quick,
        progress=lambda steps, mean: told.append((steps, mean)),
    )
    assert told[-1][0] == 2048
    found = learning.rollout(policy, PickEnv())
    assert found.best.reward == pytest.approx(0.9)
    assert found.best.subset == (2, 3)
    assert found.evaluations == 2
    assert (np.diff(found.history.reward) >= 0).all()
    model = learning.train_policy(
        lambda: PickEnv(masked=False), tmp_path / "ppo", steps=64, learning=SMALL
    )
    assert type(model).__name__ == "PPO"
    found = learning.rollout(model, PickEnv(masked=False), episodes=2, seed=1)
    assert (
        found.best.reward
        == learning.rollout(model, PickEnv(masked=False), episodes=2, seed=1).best.reward
    )
    with pytest.raises(ValueError, match="give steps or seconds"):
        learning.train_policy(PickEnv, Path("nowhere"))


def test_our_environment_is_learnt_and_its_sensors_told(make, tmp_path):
    objective = make(5, 2)
    policy = learning.train_policy(
        lambda: SensorSelectEnv(objective=objective, budget=2), tmp_path, steps=64, learning=SMALL
    )
    found = learning.rollout(policy, SensorSelectEnv(objective=objective, budget=2), episodes=3)
    assert found.best.reward == objective.score(found.best.subset).reward
    assert [sensor.name for sensor in found.sensors] == [
        objective.names[c] for c in found.best.subset
    ]
    assert objective.feasible(objective.row(found.best.subset)[None])[0]


def test_search_keeps_the_best_set_or_none_within_its_limits(make):
    for limit in ({"evaluations": 0}, {"evaluations": -1}, {"seconds": 0.0}):
        with pytest.raises(ValueError, match="must be above 0"):
            learning.search(make(3, 1), 2, **limit)
    objective = make(5, 2)
    found = learning.search(objective, 2, evaluations=64, learning=SMALL)
    assert (
        found.best.reward == exhaustive.search(objective, 2).best.reward
    )  # random play meets all 40 pairs
    assert (
        found.best.reward == objective.score(found.best.subset).reward == found.history.reward[-1]
    )
    assert (np.diff(found.history.reward) >= 0).all()
    assert found.evaluations > 64
    assert "by itself" in found.certificate.note
    assert not found.sensors
    found = learning.search(
        make(4, 1, weights=Weights(price=5.0)), 2, evaluations=32, learning=SMALL
    )
    assert found.best.subset == ()
    assert found.best.reward == 0.0


@pytest.mark.slow
def test_a_search_that_is_killed_ends_like_one_that_is_not(make, tmp_path):
    class Killed(BaseException):
        """Stands for SIGKILL."""

    class Mortal(Checkpoint):
        rounds = 0

        def save(self, state):
            super().save(state)
            self.rounds += 1
            if self.rounds == 3:
                raise Killed

    def policy(checkpoint):
        return learning.search(
            make(5, 2), 2, evaluations=1024, learning=SMALL, checkpoint=checkpoint
        )

    whole, kills = policy(NOWHERE), 0
    while True:
        try:
            found = policy(Mortal(tmp_path, every=0.0))
            break
        except Killed:
            kills += 1
    assert kills == 1
    assert (found.best, found.certificate, found.evaluations) == (
        whole.best,
        whole.certificate,
        whole.evaluations,
    )
    assert found.history.reward.tolist() == whole.history.reward.tolist()
