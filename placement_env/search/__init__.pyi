from . import cmaes as cmaes, greedy as greedy, swap as swap
from .result import (
    Assessment as Assessment,
    Certificate as Certificate,
    Contender as Contender,
    History as History,
    Result as Result,
)
from .verification import score_result as score_result, verified as verified
