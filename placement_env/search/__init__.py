"""Searches for the best set of sensors.

All work on one `Objective`, and each gives evidence of how good its answer is.

Each search is a module with `search(objective, budget, *, seed=0, seconds=None, evaluations=None) -> Result`: at most
`budget` sensors, no more on a mount than it carries, within the capacity of its link. Some take further options.
`Result` holds the best set, its history and a `Certificate` of what is known about it.

    portfolio    several of these; their answers race by the detector on fresh traffic, the winner is judged on other
    exhaustive   every set of up to 16 candidates: the optimum, the best of each size, the exact AP-kbit-price front
    greedy       one sensor after another; also `raced`, with the same arguments
    swap         change one sensor at a time until nothing improves, from several starts
    cpsat        coverage and k-coverage with a proven bound (OR-Tools)
    cmaes        height, heading and tilt of each sensor, continuous (CMA-ES)

`placement_env.rl.training` has a `search` of the same form: MaskablePPO on the environments. The other modules are what
searches share: `result`, `progress` (limits, history, incumbent), `submodular` (greedy's certificate) and
`verification` (a result scored again by a more accurate fidelity).

**AP is not submodular**, so greedy's (1 - 1/e) does not hold for it: it holds for coverage only. A set function is
submodular if what a sensor adds never grows as others join. In the paper's table of sensor sets (early fusion, IoU
0.7) it does grow. T-junction: sensor 2 alone has AP 0.2013, but added to {3} it gains 0.4591 - 0.2512 = 0.2079; sensor
0 alone has at most 0.2013 (it is not among the three best), but added to {2, 5} it gains 0.7123 - 0.4453 = 0.2670.
Roundabout: sensor 6 gains 0.9050 - 0.8678 = 0.0372 on {1, 2, 3, 5, 7}, and 0.9385 - 0.8973 = 0.0412 once 0 is there
too. Late fusion: sensor 3 alone has 0.2512, on {2, 5} it gains 0.5834 - 0.3309 = 0.2525. Greedy pays for it: at the
T-junction it starts from {4}, the best one, and {3, 4}, the best two; the best three, {0, 2, 5}, hold neither.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
