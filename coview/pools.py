"""The candidates that --candidates, --model, --sensors and --capacity of a command mean."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from placement_env.candidates.candidates import Candidates
    from toolkit.sites.site import Site


def asked_pool(site: Site, candidates: str, model: Sequence[str], sensors: Path | None) -> tuple[Candidates, str]:
    """The candidates, and the currency of their prices ("" for those of one ordinary pole). sensors: catalogue of
    models and prices. Raises ValueError where these do not fit, and what the files raise."""
    from placement_env.candidates.pool import choose_candidates
    from placement_env.candidates.sensor_catalogue import load_sensor_catalogue
    from placement_env.report.planning.question import with_terms

    if candidates == "paper" and not site.sensors:
        raise ValueError(f"site {site.name!r} has no sensors of its own: say --candidates pool")
    for option, given in (("--model", model), ("--sensors", sensors)):
        if candidates == "paper" and given:
            raise ValueError(
                f"{option} is for --candidates pool or a file of poles: the site's own sensors have theirs"
            )
    if model and sensors is not None:
        raise ValueError("--model and --sensors both say what may be mounted: leave one of them out")
    if sensors is None:
        return choose_candidates(site, candidates, _models(model)), ""
    catalogue = load_sensor_catalogue(sensors)
    models, prices = [each.model for each in catalogue.models], [each.price for each in catalogue.models]
    found = choose_candidates(site, candidates, models, prices=prices)
    pole_price = 1.0 if catalogue.pole_price is None else catalogue.pole_price
    return with_terms(found, pole_price, None), catalogue.currency


def _models(names: Sequence[str]) -> list[Any]:
    """Sensor models by name."""
    if not names:
        return []
    from toolkit.sensors.models import find_model

    return [find_model(name) for name in names]
