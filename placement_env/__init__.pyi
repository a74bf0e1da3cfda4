from .analysis.failures import Failures as Failures, failures as failures, format_failures as format_failures
from .analysis.marginal import Marginal as Marginal, format_marginal as format_marginal, marginal as marginal
from .analysis.shapley import (
    Worth as Worth,
    exact_worth as exact_worth,
    format_worth as format_worth,
    sampled_worth as sampled_worth,
    shapley as shapley,
    synergy as synergy,
)
from .candidates.candidates import Candidates as Candidates
from .candidates.poles import load_keep_out as load_keep_out, load_poles as load_poles
from .candidates.pool import paper_candidates as paper_candidates, pool as pool
from .candidates.sensor_catalogue import (
    SensorCatalogue as SensorCatalogue,
    load_sensor_catalogue as load_sensor_catalogue,
)
from .cases import Cases as Cases
from .classes import Classes as Classes
from .envs.config import PoseConfig as PoseConfig, SelectConfig as SelectConfig, SubsetConfig as SubsetConfig
from .envs.pose import SensorPoseEnv as SensorPoseEnv
from .envs.select import SensorSelectEnv as SensorSelectEnv
from .envs.subset import SensorSubsetEnv as SensorSubsetEnv
from .fidelity.combined.error_profiles import ErrorProfiles as ErrorProfiles
from .fidelity.combined.robust import Failing as Failing
from .fidelity.coverage import Coverage as Coverage
from .fidelity.detector import Detected as Detected
from .fidelity.renders import Renders as Renders
from .fidelity.surrogate import Surrogate as Surrogate
from .fidelity.table import TableFidelity as TableFidelity, load_table as load_table
from .fidelity.traffic import simulate_traffic as simulate_traffic
from .fidelity.visibility import Visibility as Visibility, see as see
from .objective import Objective as Objective, Score as Score, Scores as Scores
from .protocol import Estimate as Estimate, Fidelity as Fidelity
from .racing import Race as Race, Verified as Verified
from .report.content import Judgement as Judgement, Plan as Plan, PlanOption as PlanOption
from .report.planning.files import write_plan as write_plan
from .report.content import Planned as Planned
from .report.planning.planning import plan as plan
from .report.planning.question import Question as Question
from .rl.adapter import SB3VecEnv as SB3VecEnv, as_sb3 as as_sb3
from .rl.training import (
    Learning as Learning,
    load_policy as load_policy,
    rollout as rollout,
    train_policy as train_policy,
)
from .search import cmaes as cmaes, greedy as greedy, swap as swap
from .search.exact import cheapest as cheapest, cpsat as cpsat, exhaustive as exhaustive, hits as hits
from .search.portfolio import portfolio as portfolio
from .search.portfolio.curve import CurvePoint as CurvePoint, budget_curve as budget_curve
from .search.result import (
    Assessment as Assessment,
    Certificate as Certificate,
    Contender as Contender,
    History as History,
    Result as Result,
)
from .search.verification import rescored as rescored, verified as verified
from .setting import Setting as Setting, Weights as Weights
