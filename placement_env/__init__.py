"""What to build: candidates, objective, environments and searches. Nothing heavy loads until it is used."""

from typing import TYPE_CHECKING

from placement_env.envs.registration import register_with_gymnasium
from toolkit.runtime.lazy import lazily

# isort: off
if TYPE_CHECKING:
    from placement_env.analysis.failures import (
        Failures as Failures,
        failures as failures,
        format_failures as format_failures,
    )
    from placement_env.analysis.marginal import (
        Marginal as Marginal,
        format_marginal as format_marginal,
        marginal as marginal,
    )
    from placement_env.analysis.shapley import (
        Worth as Worth,
        exact_worth as exact_worth,
        format_worth as format_worth,
        sampled_worth as sampled_worth,
        shapley as shapley,
        synergy as synergy,
    )
    from placement_env.candidates.candidates import Candidates as Candidates
    from placement_env.candidates.poles import load_keep_out as load_keep_out, load_poles as load_poles
    from placement_env.candidates.pool import paper_candidates as paper_candidates, pool as pool
    from placement_env.candidates.sensor_catalogue import (
        SensorCatalogue as SensorCatalogue,
        load_sensor_catalogue as load_sensor_catalogue,
    )
    from placement_env.classes import Classes as Classes
    from placement_env.envs.config import (
        PoseConfig as PoseConfig,
        SelectConfig as SelectConfig,
        SubsetConfig as SubsetConfig,
    )
    from placement_env.envs.pose import SensorPoseEnv as SensorPoseEnv
    from placement_env.envs.select import SensorSelectEnv as SensorSelectEnv
    from placement_env.envs.subset import SensorSubsetEnv as SensorSubsetEnv
    from placement_env.fidelity.combined.error_profiles import ErrorProfiles as ErrorProfiles
    from placement_env.fidelity.combined.robust import Failing as Failing
    from placement_env.fidelity.coverage import Coverage as Coverage
    from placement_env.fidelity.detector import Detected as Detected
    from placement_env.protocol import Estimate as Estimate, Fidelity as Fidelity
    from placement_env.fidelity.renders import Renders as Renders
    from placement_env.fidelity.surrogate import Surrogate as Surrogate
    from placement_env.fidelity.table import TableFidelity as TableFidelity, load_table as load_table
    from placement_env.fidelity.traffic import simulate_traffic as simulate_traffic
    from placement_env.fidelity.visibility import Visibility as Visibility, see as see
    from placement_env.objective import Objective as Objective, Score as Score, Scores as Scores
    from placement_env.setting import Setting as Setting, Weights as Weights
    from placement_env.cases import Cases as Cases
    from placement_env.racing import Race as Race, Verified as Verified
    from placement_env.report.content import Judgement as Judgement, Plan as Plan, PlanOption as PlanOption
    from placement_env.report.planning.files import write_plan as write_plan
    from placement_env.report.planning.planning import Planned as Planned, plan as plan
    from placement_env.report.planning.question import Question as Question
    from placement_env.rl.adapter import SB3VecEnv as SB3VecEnv, as_sb3 as as_sb3
    from placement_env.rl.training import (
        Learning as Learning,
        load_policy as load_policy,
        rollout as rollout,
        train_policy as train_policy,
    )
    from placement_env.search import (
        cmaes as cmaes,
        greedy as greedy,
        swap as swap,
    )
    from placement_env.search.exact import cheapest as cheapest, cpsat as cpsat, exhaustive as exhaustive, hits as hits
    from placement_env.search.portfolio import portfolio as portfolio
    from placement_env.search.portfolio.curve import CurvePoint as CurvePoint, budget_curve as budget_curve
    from placement_env.search.result import (
        Assessment as Assessment,
        Certificate as Certificate,
        Contender as Contender,
        History as History,
        Result as Result,
    )
    from placement_env.search.verification import rescored as rescored, verified as verified
else:
    __getattr__, __dir__, __all__ = lazily(
        __name__,
        {
            "analysis.failures": ("Failures", "failures", "format_failures"),
            "analysis.marginal": ("Marginal", "format_marginal", "marginal"),
            "analysis.shapley": ("Worth", "exact_worth", "format_worth", "sampled_worth", "shapley", "synergy"),
            "candidates.candidates": ("Candidates",),
            "candidates.poles": ("load_keep_out", "load_poles"),
            "candidates.pool": ("paper_candidates", "pool"),
            "candidates.sensor_catalogue": ("SensorCatalogue", "load_sensor_catalogue"),
            "classes": ("Classes",),
            "envs.config": ("PoseConfig", "SelectConfig", "SubsetConfig"),
            "envs.pose": ("SensorPoseEnv",),
            "envs.select": ("SensorSelectEnv",),
            "envs.subset": ("SensorSubsetEnv",),
            "fidelity.combined.error_profiles": ("ErrorProfiles",),
            "fidelity.combined.robust": ("Failing",),
            "fidelity.coverage": ("Coverage",),
            "fidelity.detector": ("Detected",),
            "protocol": ("Estimate", "Fidelity"),
            "fidelity.renders": ("Renders",),
            "fidelity.surrogate": ("Surrogate",),
            "fidelity.table": ("TableFidelity", "load_table"),
            "fidelity.traffic": ("simulate_traffic",),
            "fidelity.visibility": ("Visibility", "see"),
            "objective": ("Objective", "Score", "Scores"),
            "racing": ("Race", "Verified"),
            "report.content": ("Judgement", "Plan", "PlanOption"),
            "report.planning.files": ("write_plan",),
            "report.planning.planning": ("Planned", "plan"),
            "report.planning.question": ("Question",),
            "rl.adapter": ("SB3VecEnv", "as_sb3"),
            "rl.training": ("Learning", "load_policy", "rollout", "train_policy"),
            "setting": ("Setting", "Weights"),
            "cases": ("Cases",),
            "search": ("cmaes", "greedy", "swap"),
            "search.exact": ("cheapest", "cpsat", "exhaustive", "hits"),
            "search.portfolio": ("portfolio",),
            "search.portfolio.curve": ("CurvePoint", "budget_curve"),
            "search.result": ("Assessment", "Certificate", "Contender", "History", "Result"),
            "search.verification": ("rescored", "verified"),
        },
    )

register_with_gymnasium()
