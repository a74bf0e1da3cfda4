from .analysis.worth import (
    estimate_worth as estimate_worth,
    exact_worth as exact_worth,
    failures as failures,
    format_failures as format_failures,
    format_worth as format_worth,
    synergy as synergy,
)
from .candidates.candidates import Candidates as Candidates
from .candidates.poles import load_poles as load_poles
from .candidates.candidates import paper_candidates as paper_candidates, pool as pool
from .cases import Cases as Cases
from .classes import Classes as Classes
from .envs.select import SensorSelectEnv as SensorSelectEnv
from .fidelity.traffic import simulate_traffic as simulate_traffic
from .fidelity.seeing import see as see
from .fidelity.visibility import Visibility as Visibility
from .live.figures import LiveAnswer as LiveAnswer
from .live.planner import LivePlanner as LivePlanner
from .objective import Objective as Objective, Score as Score
from .protocol import Estimate as Estimate, Fidelity as Fidelity
from .report.content import Plan as Plan
from .report.planning.planning import plan as plan
from .report.planning.plan_writing import write_plan as write_plan
from .report.planning.question import Question as Question, Stock as Stock
from .rl.adapter import SB3VecEnv as SB3VecEnv, as_sb3 as as_sb3
from .rl.training import rollout as rollout, train_policy as train_policy
from .search import greedy as greedy, swap as swap
from .search.exact import cpsat as cpsat, exhaustive as exhaustive, hits as hits
from .search.portfolio import portfolio as portfolio
from .search.result import Result as Result
from .setting import Setting as Setting, Weights as Weights
