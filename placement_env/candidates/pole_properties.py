"""Which properties of a file of poles were not understood, and what each of them may have meant.

GIS exports call things as their owners do: `Height`, `cost_eur`, `Höhe_m`. None of that is guessed into a plan: it is
named, with the property that was meant where one is near.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any

UNDERSTOOD = {
    "name": "name",
    "height": "height (m above the foot)",
    "max_height": "max_height (m above the foot)",
    "min_height": "min_height (m above the foot)",
    "price": "price (1: that of an ordinary pole)",
    "capacity_kbit": "capacity_kbit (of the link, per frame)",
    "max_sensors": "max_sensors (that the pole may carry)",
    "keep_out": "keep_out (true or false, of a polygon)",
}
SILENT = {"capacity", "kind", "layer", "used"}  # understood, or written by coview itself
WORDS = {
    "min_height": ("min", "minimum", "lowest"),
    "max_height": ("max", "maximum", "highest"),
    "height": ("height", "hgt", "hoehe", "höhe", "hauteur", "altura", "elevation"),
    "price": ("price", "cost", "costs", "preis", "kosten", "eur", "euro", "usd", "money"),
    "capacity_kbit": ("capacity", "kapazität", "bandwidth", "bitrate", "kbit", "kbits", "mbit", "mbits", "link"),
    "keep_out": ("keepout", "forbidden", "exclude", "exclusion", "barred"),
    "name": ("name", "label", "title", "ref"),
}


def not_understood(properties: Iterable[Mapping[str, Any]], *, areas: bool = False) -> str:
    """The properties that coview does not know, each once and in the order of the file, with what may have been meant;
    "" where it knows all of them. areas: the features are polygons, which have many properties of their own: only what
    may have meant keep_out counts.

    >>> not_understood([{"name": "L1", "Height": 9}, {"cost_eur": 900, "owner": "tram"}])
    'Height: height (m above the foot)?, cost_eur: price (1: that of an ordinary pole)?, owner'
    """
    unknown = dict.fromkeys(key for each in properties for key in each if key not in UNDERSTOOD and key not in SILENT)
    meant = {key: property_meant(key) for key in unknown}
    if areas:
        meant = {key: near for key, near in meant.items() if near == "keep_out"}
    return ", ".join(key[:60] if near is None else f"{key[:60]}: {UNDERSTOOD[near]}?" for key, near in meant.items())


def property_meant(key: str) -> str | None:
    """The property that is near to a name in other letters, words or units; None where none is.

    >>> [property_meant(key) for key in ("MAX HEIGHT", "heigth", "Höhe_m", "KeepOut", "linkMbit", "material")]
    ['max_height', 'height', 'height', 'keep_out', 'capacity_kbit', None]
    """
    parts = [part.lower() for part in re.findall(r"[^\W\d_]+", re.sub(r"(?<=[a-zäöü])(?=[A-ZÄÖÜ])", "_", key))]
    joined = {*parts, "".join(parts)}
    for meant, words in WORDS.items():
        if joined & set(words):
            return meant
    close = get_close_matches("_".join(parts), UNDERSTOOD, 1, 0.75)
    return close[0] if close else None
