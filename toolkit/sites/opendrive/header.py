"""What an OpenDRIVE file says of itself: that it is one, where its roads are, its projection."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

NAMES_PROJECTION = r"\+proj=(?!lat|lon)|EPSG:|PROJ(CS|CRS|ECTEDCRS)\b"  # in degrees there is no map in metres


def opendrive_header(path: Path, centre: tuple[float, float]) -> str | None:
    """The projection an OpenDRIVE file names; ValueError where it is none or `centre` is not in it."""
    starts, lengths, reference = [], [], None
    try:
        parser = ElementTree.iterparse(path, events=("start", "end"))
        for i, (event, element) in enumerate(parser):
            if i == 0 and element.tag.rpartition("}")[2] != "OpenDRIVE":
                raise ValueError(f"{path}: not an OpenDRIVE map (it begins with <{element.tag}>): give an .xodr file")
            tag = element.tag.rpartition("}")[2]
            if event == "end" and tag == "geoReference":
                reference = (element.text or "").strip() or None
            elif event == "end" and tag == "geometry":
                starts.append([float(element.get(key, "nan")) for key in "xy"])
                lengths.append(float(element.get("length", "nan")))
            elif event == "end" and tag == "road":
                element.clear()
    except ElementTree.ParseError as error:
        raise ValueError(f"{path}: not an OpenDRIVE map or a damaged one ({error}): give an .xodr file") from None
    if not starts or not np.isfinite(starts).all() or not np.isfinite(lengths).all():
        raise ValueError(f"{path}: the map has no road, or one without x, y and length: export it again")
    low, high = np.min(starts, axis=0) - max(lengths), np.max(starts, axis=0) + max(lengths)
    if not ((low <= centre) & (centre <= high)).all():
        low, high = np.min(starts, axis=0), np.max(starts, axis=0)
        raise ValueError(
            f"{path}: centre {centre[0]:g} {centre[1]:g} lies outside the map, whose roads start at x {low[0]:.6g} to "
            f"{high[0]:.6g} and y {low[1]:.6g} to {high[1]:.6g}: give --centre X Y inside it"
        )
    return reference


def usable(geo_reference: str | None, path: Path) -> str | None:
    """The projection, None for a text that names none, of which a warning is given."""
    if geo_reference is None or re.search(NAMES_PROJECTION, geo_reference, re.IGNORECASE):
        return geo_reference
    said = f"its geoReference names no projection ({geo_reference[:90]!r})"
    warnings.warn(f"{path.name}: {said}, so the site does not say where on earth it is", stacklevel=3)
    return None
