"""`coview propose`: which sensors to place, by the map alone and at once."""

from __future__ import annotations

import math
from pathlib import Path

from tyro.conf import Positional

from coview.arguments import check_least
from coview.exits import NOT_MET, OK
from coview.pools import asked_pool
from coview.printing import print_result


def propose(
    site: Positional[str],
    /,
    *,
    budget: int = 3,
    candidates: str = "pool",
    model: tuple[str, ...] = (),
    sensors: Path | None = None,
    money: float | None = None,
    comm: float = 0.0,
    price: float = 0.0,
    policy: Path | None = None,
    look: bool = True,
    json: bool = False,
) -> int:
    """Answer which sensors to place by the map alone: a trained policy, no traffic simulated, and at once.

    A first answer, to start from: coview search and coview plan look for themselves and judge what they find.

    Example: coview propose tjunction --budget 3

    Args:
        site: tjunction, roundabout, or a site file.
        budget: Most sensors; a pole carries one, or as many as its max_sensors says.
        candidates: pool, paper or a GeoJSON file of poles, as in coview search.
        model: Sensor models that may be mounted, by name; the paper's camera when left out.
        sensors: Catalogue of sensor models and their prices instead, TOML, as for coview plan.
        money: Most that the set may cost, in the catalogue's currency, or in ordinary poles.
        comm: AP that a kbit per sensor and frame costs.
        price: AP that one ordinary mount costs.
        policy: File of another policy (.safetensors) than the shipped one.
        look: Look at the empty site from the chosen sensors, to know that their links carry what they send.
        json: Print as JSON.
    """
    from placement_env.envs.maps.terms import Terms
    from placement_env.objective import Weights
    from placement_env.rl.maps.map_policy import SHIPPED_POLICY, MapPolicy
    from toolkit.sites.files import load_site

    check_least("--budget", budget, 1)
    for option, value in (("--money", money), ("--comm", comm), ("--price", price)):
        check_least(option, value, 0)
    place, trained = load_site(site), MapPolicy.load(policy or SHIPPED_POLICY)
    some, currency = asked_pool(place, candidates, model, sensors)
    most = math.inf if money is None else money
    terms = Terms.plain(some, budget, weights=Weights(comm, price), most_price=most)
    answer = trained.proposal(place, terms, look=look)
    names = [some.sensors[member].name for member in answer.members]
    told = {
        "sensors": names, "predicted_ap": answer.ap, "price": terms.price(answer.members), "currency": currency,
        "candidates": len(some), "seconds": answer.seconds, "policy": trained.source,
    }  # fmt: skip
    last = f"of {len(some)} candidates in {answer.seconds:.1f} s; AP {answer.ap:.3f} is predicted, not judged"
    lines = [*names, last] if names else ["no candidate is worth it on these terms"]
    print_result(told, "\n".join(lines), as_json=json)
    return OK if names else NOT_MET
