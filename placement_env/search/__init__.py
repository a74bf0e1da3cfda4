"""Searches for the best set of sensors on one `Objective`, each with evidence of how good its
answer is.

Each is a module with `search(objective, budget, *, seed=0, seconds=None, evaluations=None) ->
Result`: at most `budget` sensors, no more on a mount than it carries, within the capacity of its
link. Some take further options.

    portfolio    several searches; their answers race by the detector on fresh traffic, and the
                 winner is judged on other traffic
    exhaustive   every set of up to 16 candidates: the optimum, the best of each size, the exact
                 AP-kbit-price front
    greedy       one sensor after another; also `search_by_races`, with the same arguments
    swap         change one sensor at a time until nothing improves, from several starts
    cpsat        coverage and k-coverage with a proven bound (OR-Tools)
    hits         expected hits with a proven bound (OR-Tools)
    cheapest     the cheapest set that reaches an AP, with a proven bound on the price (OR-Tools)
    cmaes        height, heading and tilt of each sensor, continuous (CMA-ES)

`placement_env.rl.training` has a `search` of the same form: MaskablePPO on the environments.

**AP is not submodular**: the gain of a sensor may grow as others join, so greedy's (1 - 1/e) holds
for coverage only. In the paper's table (T-junction, early fusion, IoU 0.7) the set {2} has AP
0.2013, but sensor 2 added to {3} gains 0.2079. Greedy starts there from {4}, the best one, and
{3, 4}, the best two; the best three, {0, 2, 5}, hold neither.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
