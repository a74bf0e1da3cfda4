"""Figures of a plan as words: shares, prices, names, AP with its interval, and sensors by the names of their poles."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

from placement_env.report import content
from placement_env.report.pages.document import NONE, number
from toolkit.display import describe_count
from toolkit.sites.site import Site


def percent(share: float | None) -> str:
    """Format a share in percent, never rounded to 0 or 100 %.

    >>> percent(0.934), percent(0.0004), percent(1.0)
    ('93%', 'under 1%', '100%')
    """
    if share is None or not math.isfinite(share):
        return NONE
    if 0 < share < 0.01:
        return "under 1%"
    return "over 99%" if 0.99 < share < 1 else f"{100 * share:.0f}%"


def price_text(price: float, currency: str) -> str:
    """Format a price. Without a currency it is in units of one ordinary pole.

    >>> price_text(1250.0, "EUR"), price_text(1.0, ""), price_text(2.5, "")
    ('1,250 EUR', '1 unit', '2.5 units')
    """
    text = f"{price:,.{0 if price == round(price) else 2}f}"
    if currency:
        return f"{text} {currency}"
    return f"{text.rstrip('0').rstrip('.') if '.' in text else text} unit{'s' * (price != 1)}"


def ap_text(judged: content.Judgement) -> str:
    """AP with interval and number of vehicles.

    >>> ap_text(content.Judgement(0.95, 0.91, 0.98, 0.96, 0.97, 40, 20))
    'AP 0.950 (0.910–0.980, 40 vehicles)'
    """
    return f"AP {ap_figure(judged)}"


def ap_figure(judged: content.Judgement) -> str:
    """AP with interval and number of vehicles, without the word AP."""
    return f"{number(judged.ap)} ({interval_text(judged)}, {describe_count(judged.vehicles, judged.kind)})"


def list_aps(judged: Iterable[tuple[str, content.Judgement]]) -> str:
    """AP of each name, for screen readers."""
    return "; ".join(f"{name}: {ap_text(each)}" for name, each in judged)


def interval_text(judged: content.Judgement) -> str:
    """Both ends of the interval, if it has one."""
    return "no interval" if math.isnan(judged.low) else f"{number(judged.low)}–{number(judged.high)}"


def use_pole_names(plan: content.Plan, site: Site) -> tuple[content.Plan, Site]:
    """Call the sensors of a pool by their poles, in all texts of a plan and on its site.

    Sensors of the chosen set that share a pole are numbered; other aims than the chosen ones are marked.
    """
    poles = {name: pole for each in plan.considered for name, pole in zip(each.sensors, each.poles, strict=False)}
    poles |= {sensor.name: sensor.pole for sensor in plan.sensors}
    names = {}
    for name, pole in poles.items():
        alike = [sensor.name for sensor in plan.sensors if sensor.pole == pole]
        if name in alike:
            names[name] = pole if len(alike) == 1 else f"{pole} ({alike.index(name) + 1})"
        else:
            names[name] = f"{pole} (other aim)" if alike else pole
    names = {name: each for name, each in names.items() if name.startswith(f"{poles[name].replace('/', '-')}_")}
    if not names:
        return plan, site
    long_first = "|".join(map(re.escape, sorted(names, key=len, reverse=True)))

    def rename(value: Any) -> Any:
        if isinstance(value, str):
            return names.get(value) or re.sub(long_first, lambda found: names[found[0]], value)
        if isinstance(value, Mapping):
            return {rename(key): rename(each) for key, each in value.items()}
        if isinstance(value, tuple | list):
            return tuple(map(rename, value))
        if is_dataclass(value) and not isinstance(value, type):
            return replace(value, **{each.name: rename(getattr(value, each.name)) for each in fields(value)})
        return value

    sensors = tuple(replace(each, name=names.get(each.name, each.name)) for each in site.sensors)
    return rename(plan), replace(site, sensors=sensors)
