"""Training of policies that place sensors.

MaskablePPO (sb3-contrib) trains environments with action masks, PPO (Stable-Baselines3) all others,
in rounds of some updates. Each round starts from reset environments and generators seeded by the
run's seed and its number, so a training that is interrupted and resumed ends with the same weights.
Checkpoints hold only tensors and numbers.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

from placement_env.envs.env import AnyEnv, PlacementEnv
from placement_env.envs.select import SensorSelectEnv
from placement_env.envs.state import Info
from placement_env.objective import Objective, Score
from placement_env.rl.learning import Learning
from placement_env.search.checkpoint import Checkpoint, KeptState
from placement_env.search.checkpoint_folder import NOWHERE
from placement_env.search.progress import Limits
from placement_env.search.result import Certificate, Result
from toolkit.sensors.sensor import Sensor

if TYPE_CHECKING:
    from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm

Watch = Callable[[list[Info]], None]  # called with the infos of each step, one per environment
Rounds = list[list[Any]]  # [steps done, state of a search] each, the earliest first
POLICY_FILE = "policy.pt"
DEFAULT_STEPS = 50_000  # that `search` trains without a limit
POLICY_EPISODES = 20  # episodes of the trained policy in a search
ROUND_UPDATES = 4  # updates in a round
MAX_KEPT_ROUNDS = 1000  # whose search states are kept; a policy is kept far more often
USUAL_LEARNING = Learning()
# for a search, which keeps its best set and so may explore more
EXPLORING_LEARNING = Learning(entropy=0.3)


def _check_poles(objective: Objective) -> None:
    """Raise ValueError if poles must carry a sensor."""
    if objective.setting.keep:
        raise ValueError(
            "a policy does not know poles that must carry a sensor: pass --method portfolio or swap"
        )


def search(
    objective: Objective,
    budget: int,
    *,
    seed: int = 0,
    seconds: float | None = None,
    evaluations: int | None = None,
    learning: Learning = EXPLORING_LEARNING,
    checkpoint: Checkpoint = NOWHERE,
) -> Result:
    """Best set that MaskablePPO meets while training on this objective, or in episodes after that.

    Every step counts as an evaluation; without a limit `DEFAULT_STEPS` are trained. Then the policy
    plays `POLICY_EPISODES` episodes, which no limit stops.

    Args:
        objective: Objective to maximise.
        budget: Largest number of sensors.
        seed: Seed of training and episodes.
        seconds: Time limit of the training, None for none.
        evaluations: Most steps to train, None for no limit.
        learning: Settings of the training.
        checkpoint: Keeps the policy, and the best set up to each round.

    Raises ValueError if poles must carry a sensor.
    """
    _check_poles(objective)
    steps = DEFAULT_STEPS if seconds is None and evaluations is None else evaluations
    episodes = _BestEpisode(objective, Limits(seconds, evaluations))
    limits = episodes.limits

    def make_env() -> SensorSelectEnv:
        return SensorSelectEnv(objective=objective, budget=budget)

    with TemporaryDirectory() as temporary:
        folder = checkpoint.place("policy") or Path(temporary)
        saved = checkpoint.load()
        rounds = [] if saved is None else saved["rounds"]
        restored = restore_rounds(folder, rounds)
        if restored is not None:
            episodes.resume(restored)

        def save_round(done: int, _: float) -> None:
            """Add the state after a round; the kept policy may be of an earlier one."""
            rounds.append([done, episodes.state()])
            checkpoint.save({"rounds": rounds[-MAX_KEPT_ROUNDS:]})

        remaining_s = None if seconds is None else max(0.0, seconds - limits.elapsed)
        policy = train_policy(
            make_env,
            folder,
            steps=steps,
            seconds=remaining_s,
            seed=seed,
            learning=replace(learning, checkpoint_s=checkpoint.every),
            watch=episodes.watch,
            progress=save_round,
        )
    rolled_out = rollout(policy, make_env(), episodes=POLICY_EPISODES, seed=seed)
    limits.count += rolled_out.evaluations
    trained_score = objective.score(np.flatnonzero(episodes.subset))
    is_better = rolled_out.best.reward > trained_score.reward
    best_score = rolled_out.best if is_better else trained_score
    note = f"the trained policy reaches {rolled_out.best.reward:.4f} by itself"
    return _build_result(objective, best_score, limits, note)


class _BestEpisode:
    """Best set that episodes of a training end with, and the limits and history of the search.

    Attributes:
        limits: Steps done, time and improvements so far.
        reward: Reward of the best set; 0, as of the empty set, before a better one.
        subset: Best set, as a row of booleans.
    """

    def __init__(self, objective: Objective, limits: Limits) -> None:
        self._objective = objective
        self.limits = limits
        self.reward = 0.0
        self.subset = np.zeros(len(objective.candidates), np.bool_)

    def watch(self, infos: list[Info]) -> None:
        """Count a step of each environment, and keep the set of an ended episode if it is the best.

        infos: info of each environment after the step, with "episode" if its episode ended."""
        self.limits.count += len(infos)
        for info in infos:
            # "r", the return of an episode, is the reward of its final set
            if "episode" in info and info["episode"]["r"] > self.reward:
                self.reward = info["episode"]["r"]
                self.subset = info["subset"]
                self.limits.record(self.reward)

    def state(self) -> KeptState:
        """JSON values for a checkpoint, from which `resume` continues."""
        return {
            "limits": self.limits.state(),
            "best": self.reward,
            "chosen": np.flatnonzero(self.subset).tolist(),
        }

    def resume(self, state: KeptState) -> None:
        """Resume from the values that `state` returned in an earlier run."""
        self.limits.resume(state["limits"])
        self.reward = float(state["best"])
        self.subset = self._objective.row(state["chosen"])


def _build_result(objective: Objective, best: Score, limits: Limits, note: str) -> Result:
    """Return the result of `search` for the best set.

    limits: steps, time and history of the search; note: sentence on what the policy reaches."""
    return Result(
        method="policy",
        best=best,
        history=limits.history(best.reward),
        certificate=Certificate("none", best.reward, note=note),
        evaluations=limits.count,
        seconds=limits.elapsed,
        origin=objective.describe_origin(best.subset),
    )


def train_policy(
    make_env: Callable[[], AnyEnv],
    out: Path,
    *,
    steps: int | None = None,
    seconds: float | None = None,
    seed: int = 0,
    learning: Learning = USUAL_LEARNING,
    progress: Callable[[int, float], None] | None = None,
    watch: Watch | None = None,
) -> "OnPolicyAlgorithm":
    """Train until `steps` environment steps are done in all, or `seconds` in this call, in whole
    rounds.

    `out/policy.pt` is kept; called again with the folder, training resumes. At least one limit is
    needed.

    Args:
        make_env: Function that makes an environment.
        out: Folder of the policy, made if missing.
        steps: Steps to be done in all, earlier calls included; None for no limit.
        seconds: Time of this call, None for no limit.
        seed: Seed of all rounds.
        learning: Settings of the training.
        progress: Called after each round with the steps done and the mean return of the last 100
            episodes, NaN before the first.
        watch: Called with the infos of each step.

    Raises ValueError without a limit and if `out` holds another training, ImportError without the
    libraries.
    """
    from models.weight_files import read_checkpoint

    if steps is None and seconds is None:
        raise ValueError("training needs an end: give steps or seconds")
    out.mkdir(parents=True, exist_ok=True)
    # identity: settings that a resumed training must share
    model, identity = _build_model(make_env, learning, seed)
    if (out / POLICY_FILE).exists():
        state = read_checkpoint(out / POLICY_FILE, identity=identity)
        model.policy.load_state_dict(state["policy"])
        model.policy.optimizer.load_state_dict(state["optimiser"])
        model.num_timesteps = state["steps"]

    def callback(local: Info, _: object) -> bool:
        """Pass the infos of a step on to `watch`; return True, as False would end the training.

        local: local variables of Stable-Baselines3, which calls this."""
        if watch is not None:
            watch(local["infos"])
        return True

    began = saved = time.monotonic()
    round_steps = ROUND_UPDATES * learning.envs * learning.rollout
    while model.num_timesteps < (np.inf if steps is None else steps):
        if time.monotonic() - began >= (np.inf if seconds is None else seconds):
            break
        # seeds every generator and environment
        model.set_random_seed(_draw_round_seed(seed, model.num_timesteps // round_steps))
        model.set_env(model.get_env(), force_reset=True)  # type: ignore[arg-type]
        model.learn(round_steps, callback=callback, reset_num_timesteps=False)
        if progress:
            returns = [episode["r"] for episode in model.ep_info_buffer or ()]
            progress(model.num_timesteps, float(np.mean(returns)) if returns else float("nan"))
        if time.monotonic() - saved > learning.checkpoint_s:
            _save_policy(model, identity, out)
            saved = time.monotonic()
    _save_policy(model, identity, out)
    return model


def _save_policy(model: "OnPolicyAlgorithm", identity: Mapping[str, object], out: Path) -> None:
    """Write the policy with its optimiser and number of steps, whole or not at all.

    identity: settings that a resumed training must share; out: folder of the policy."""
    from models.weight_files import save_atomically

    state = {
        "steps": model.num_timesteps,
        "policy": model.policy.state_dict(),
        "optimiser": model.policy.optimizer.state_dict(),
    }
    save_atomically(out / POLICY_FILE, {**identity, **state})


def _draw_round_seed(seed: int, round_number: int) -> int:
    """Seed of a round, the same whenever its training is resumed."""
    state = np.random.SeedSequence([seed, round_number]).generate_state(1)[0]
    return int(state >> 1)  # 31 of its 32 bits fit a signed int


def restore_rounds(folder: Path, rounds: Rounds) -> KeptState | None:
    """State of a search after the round of the kept policy, None to begin from the start.

    Later rounds are dropped from `rounds` in place. Without a state for the policy's round, all
    rounds and the policy are removed, because one is of no use without the other.

    folder: folder of `POLICY_FILE`; rounds: a pair [steps done, state] after each round, the
    earliest first.
    """
    from models.weight_files import read_checkpoint

    path = folder / POLICY_FILE
    policy_steps = read_checkpoint(path)["steps"] if path.exists() else 0
    rounds[:] = [[steps, state] for steps, state in rounds if steps <= policy_steps]
    if rounds:
        last_steps, last_state = rounds[-1]
        if last_steps == policy_steps:
            return dict(last_state)
    rounds.clear()
    path.unlink(missing_ok=True)
    return None


def rollout(
    policy: "OnPolicyAlgorithm",
    env: AnyEnv,
    *,
    episodes: int = 1,
    seed: int = 0,
    options: Info | None = None,
) -> Result:
    """Best set that a policy meets in some episodes from the same reset.

    The first episode takes the likeliest actions, the others draw them from the policy. Every step
    counts as an evaluation, and its set competes. The result has the sensors of the best set if the
    environment is coview's.

    policy: model with `predict`; seed: for the reset and the drawn actions; options: for the
    reset. Raises ValueError for fewer than one episode.
    """
    import torch

    limits = Limits(None, None)
    has_masks = _has_masks(env)
    torch.manual_seed(seed)
    best: Score | None = None
    sensors: tuple[Sensor, ...] = ()
    for episode in range(episodes):
        observation, _ = env.reset(seed=seed, options=options)
        ended = False
        while not ended:
            mask = {"action_masks": env.get_wrapper_attr("action_masks")()} if has_masks else {}
            action, _ = policy.predict(observation, deterministic=episode == 0, **mask)
            observation, _, terminated, truncated, info = env.step(action)
            limits.count += 1
            score = _read_score(info)
            if best is None or score.reward > best.reward:
                best = score
                limits.record(best.reward)
                if isinstance(env.unwrapped, PlacementEnv):
                    objective, members = env.unwrapped.placement()
                    sensors = tuple(objective.candidates.sensors[member] for member in members)
            ended = terminated or truncated
    if best is None:
        raise ValueError(f"episodes must be at least 1, got {episodes}")
    certificate = Certificate("none", best.reward, note="a policy promises nothing")
    return Result(
        method="policy",
        best=best,
        history=limits.history(best.reward),
        certificate=certificate,
        evaluations=limits.count,
        seconds=limits.elapsed,
        sensors=sensors,
    )


def _read_score(info: Info) -> Score:
    """Score of the set of sensors after a step of an environment, from the info of the step."""
    terms = {name: float(term) for name, term in info["reward_terms"].items()}
    subset = np.asarray(info["subset"])
    # some environments give a row of booleans, others indices
    members = np.flatnonzero(subset) if subset.dtype == bool else subset
    return Score(
        subset=tuple(members.tolist()),
        ap=float(info["ap"]),
        recall=float(info["recall"]),
        kbit_per_sensor=float(info["kbit_per_sensor"]),
        kbit=float(info["kbit"]),
        price=float(info["price"]),
        reward=sum(terms.values()),
        terms=terms,
        fidelity=str(info["fidelity"]),
        cache_hit=bool(info["cache_hit"]),
    )


def _has_masks(env: AnyEnv) -> bool:
    """True if the environment has action masks of a kind that MaskablePPO takes."""
    is_discrete = isinstance(
        env.action_space, gym.spaces.Discrete | gym.spaces.MultiDiscrete | gym.spaces.MultiBinary
    )
    return is_discrete and env.has_wrapper_attr("action_masks")


def _build_model(
    make_env: Callable[[], AnyEnv], learning: Learning, seed: int
) -> "tuple[OnPolicyAlgorithm, Mapping[str, object]]":
    """Untrained model, and the settings that two trainings must share to be the same.

    The settings are kept with the policy and compared when training resumes. make_env: function
    that makes an environment, called for each of `Learning.envs`; seed: for the first weights."""
    try:
        from sb3_contrib import MaskablePPO
        from stable_baselines3 import PPO
        from stable_baselines3.common.logger import Logger
    except ImportError as error:
        raise ImportError(
            "policies need Stable-Baselines3 and sb3-contrib: pip install coview[rl]"
        ) from error
    from placement_env.rl.adapter import vectorize
    from placement_env.rl.policy_network import CandidatePolicy

    first = make_env()
    algorithm: Any = MaskablePPO if _has_masks(first) else PPO
    one_by_one = isinstance(first.unwrapped, SensorSelectEnv) and isinstance(
        first.action_space, gym.spaces.Discrete
    )
    model: OnPolicyAlgorithm = algorithm(
        CandidatePolicy if one_by_one else "MlpPolicy",
        vectorize(first, make_env, learning.envs, augment=learning.augment),
        n_steps=learning.rollout,
        batch_size=learning.batch,
        n_epochs=learning.epochs,
        learning_rate=learning.learning_rate,
        ent_coef=learning.entropy,
        gamma=learning.discount,
        policy_kwargs={"net_arch": [learning.width, learning.width]},
        seed=seed,
        device="cpu",
    )
    model.set_logger(Logger(None, []))  # or every round leaves a folder behind
    return model, {
        "algorithm": algorithm.__name__,
        "spaces": f"{model.observation_space} {model.action_space}",
        "learning": str(learning),
        "seed": seed,
    }
