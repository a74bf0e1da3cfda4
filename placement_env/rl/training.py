"""Training of policies that place sensors.

MaskablePPO (sb3-contrib) trains environments with action masks, PPO (Stable-Baselines3) all others,
in rounds of some updates. Each round starts from reset environments and generators seeded by the
run's seed and its number, so a training that is interrupted and resumed ends with the same weights.
Checkpoints hold only tensors and numbers.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np

from placement_env.envs.env import AnyEnv, PlacementEnv
from placement_env.envs.select import SensorSelectEnv
from placement_env.envs.state import Info
from placement_env.objective import Objective, Score
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


@dataclass(frozen=True)
class Learning:
    """Settings of a training with PPO (Schulman et al. 2017). Episodes are short, so without
    discount.

    Attributes:
        envs: Environments that are stepped together.
        rollout: Steps of each environment between updates.
        batch: Size of a minibatch.
        epochs: Passes over the steps of an update.
        learning_rate: Learning rate.
        entropy: Weight of the entropy.
        discount: Discount of rewards.
        width: Width of the two hidden layers, or of `policy_network` if candidates are chosen one
            after another.
        augment: Whether junctions are rotated and mirrored at random in every episode, so that a
            policy for several memorises less of them (only coview's environments).
        checkpoint_s: Seconds between checkpoints.
    """

    envs: int = 16
    rollout: int = 16
    batch: int = 64
    epochs: int = 2
    learning_rate: float = 2e-3
    entropy: float = 0.01
    discount: float = 1.0
    width: int = 32
    augment: bool = False
    checkpoint_s: float = field(default=60.0, repr=False, compare=False)


PLAIN = Learning()
EXPLORING = Learning(entropy=0.3)  # a search keeps its best set, so it may explore more


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
    learning: Learning = EXPLORING,
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
    limits = Limits(seconds, evaluations)
    best = 0.0
    chosen = np.zeros(len(objective.candidates), np.bool_)  # the best set, of reward `best`

    def make_env() -> SensorSelectEnv:
        return SensorSelectEnv(objective=objective, budget=budget)

    def watch(infos: list[Info]) -> None:
        nonlocal best, chosen
        # the return of an episode is the reward of its final set
        limits.count += len(infos)
        for info in infos:
            if "episode" in info and info["episode"]["r"] > best:
                best = info["episode"]["r"]
                chosen = info["subset"]
                limits.record(best)

    with TemporaryDirectory() as temporary:
        folder = checkpoint.place("policy") or Path(temporary)
        rounds = [] if (saved := checkpoint.load()) is None else saved["rounds"]
        if (restored := restore_rounds(folder, rounds)) is not None:
            limits.resume(restored["limits"])
            best = float(restored["best"])
            chosen = objective.row(restored["chosen"])

        def note(done: int, _: float) -> None:
            # adds the state after a round; the kept policy may be of an earlier one
            state = {
                "limits": limits.state(),
                "best": best,
                "chosen": np.flatnonzero(chosen).tolist(),
            }
            rounds.append([done, state])
            checkpoint.save({"rounds": rounds[-MAX_KEPT_ROUNDS:]})

        remaining_s = None if seconds is None else max(0.0, seconds - limits.elapsed)
        frequent = replace(learning, checkpoint_s=checkpoint.every)
        policy = train_policy(
            make_env,
            folder,
            steps=steps,
            seconds=remaining_s,
            seed=seed,
            learning=frequent,
            watch=watch,
            progress=note,
        )
    rolled_out = rollout(policy, make_env(), episodes=POLICY_EPISODES, seed=seed)
    limits.count += rolled_out.evaluations
    trained = objective.score(np.flatnonzero(chosen))
    best_score = rolled_out.best if rolled_out.best.reward > trained.reward else trained
    note_text = f"the trained policy reaches {rolled_out.best.reward:.4f} by itself"
    return _build_result(objective, best_score, limits, note_text)


def _build_result(objective: Objective, best: Score, limits: Limits, note: str) -> Result:
    """Return the result of `search` for the best set. note: sentence on what the policy reaches."""
    certificate = Certificate("none", best.reward, note=note)
    origin = objective.describe_origin(best.subset)
    history = limits.history(best.reward)
    return Result("policy", best, history, certificate, limits.count, limits.elapsed, origin=origin)


def train_policy(
    make_env: Callable[[], AnyEnv],
    out: Path,
    *,
    steps: int | None = None,
    seconds: float | None = None,
    seed: int = 0,
    learning: Learning = PLAIN,
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
    from models.weight_files import read_checkpoint, save_atomically

    if steps is None and seconds is None:
        raise ValueError("training needs an end: give steps or seconds")
    out.mkdir(parents=True, exist_ok=True)
    model, identity = _model(make_env, learning, seed)
    if (out / POLICY_FILE).exists():
        state = read_checkpoint(out / POLICY_FILE, identity=identity)
        model.policy.load_state_dict(state["policy"])
        model.policy.optimizer.load_state_dict(state["optimiser"])
        model.num_timesteps = state["steps"]

    def callback(local: Info, _: object) -> bool:
        # Stable-Baselines3 calls it with its local variables; False would end the training
        if watch is not None:
            watch(local["infos"])
        return True

    def save() -> None:
        modules: dict[str, Any] = {"policy": model.policy, "optimiser": model.policy.optimizer}
        state = {"steps": model.num_timesteps} | {
            name: module.state_dict() for name, module in modules.items()
        }
        save_atomically(out / POLICY_FILE, {**identity, **state})

    began = saved = time.monotonic()
    per_round = ROUND_UPDATES * learning.envs * learning.rollout
    while model.num_timesteps < (np.inf if steps is None else steps):
        if time.monotonic() - began >= (np.inf if seconds is None else seconds):
            break
        number = model.num_timesteps // per_round  # seeds every generator and environment
        # `>> 1` leaves 31 of 32 bits: a seed that fits a signed number
        model.set_random_seed(int(np.random.SeedSequence([seed, number]).generate_state(1)[0] >> 1))
        model.set_env(model.get_env(), force_reset=True)  # type: ignore[arg-type]
        model.learn(per_round, callback=callback, reset_num_timesteps=False)
        if progress:
            returns = [episode["r"] for episode in model.ep_info_buffer or ()]
            progress(model.num_timesteps, float(np.mean(returns)) if returns else float("nan"))
        if time.monotonic() - saved > learning.checkpoint_s:
            save()
            saved = time.monotonic()
    save()
    return model


def restore_rounds(folder: Path, rounds: Rounds) -> KeptState | None:
    """State of a search after the round of the kept policy, None to begin from the start.

    Later rounds are dropped from `rounds`, which changes. Without a state for the policy's round,
    all rounds and the policy are removed, because one is of no use without the other.

    folder: folder of `POLICY_FILE`; rounds: steps done and state after each round.
    """
    from models.weight_files import read_checkpoint

    path = folder / POLICY_FILE
    steps = read_checkpoint(path)["steps"] if path.exists() else 0
    rounds[:] = [row for row in rounds if row[0] <= steps]
    if rounds and rounds[-1][0] == steps:
        return dict(rounds[-1][1])
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
            score = _score(info)
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
        "policy",
        best,
        limits.history(best.reward),
        certificate,
        limits.count,
        limits.elapsed,
        sensors=sensors,
    )


def _score(info: Info) -> Score:
    # score of the set after a step, from its info; `subset` holds booleans or indices
    terms = {name: float(term) for name, term in info["reward_terms"].items()}
    subset = np.asarray(info["subset"])
    members = np.flatnonzero(subset) if subset.dtype == bool else subset
    figures: dict[str, Any] = {
        n: float(info[n]) for n in ("ap", "recall", "kbit_per_sensor", "kbit", "price")
    }
    figures |= {"fidelity": str(info["fidelity"]), "cache_hit": bool(info["cache_hit"])}
    return Score(tuple(members.tolist()), reward=sum(terms.values()), terms=terms, **figures)


def _has_masks(env: AnyEnv) -> bool:
    """True if the environment has action masks of a kind that MaskablePPO takes."""
    is_discrete = isinstance(
        env.action_space, gym.spaces.Discrete | gym.spaces.MultiDiscrete | gym.spaces.MultiBinary
    )
    return is_discrete and env.has_wrapper_attr("action_masks")


def _model(
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
