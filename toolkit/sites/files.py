"""Sites as files: the built-in ones by name, saved ones by path."""

from __future__ import annotations

from pathlib import Path

from toolkit.runtime.files import read_json, write_text
from toolkit.sites import BUILT_IN
from toolkit.sites.geojson import dumps, parse
from toolkit.sites.site import Site


def load_site(name_or_path: str | Path) -> Site:
    """A built-in site by name ("tjunction", "roundabout"), or a saved one by path.

    Raises ValueError, in one line with file, field, rule and value, where the file is damaged; FileNotFoundError where
    there is neither such a file nor such a built-in site.
    """
    path = Path(name_or_path)
    if str(name_or_path) in BUILT_IN:
        path = Path(__file__).parent / f"{name_or_path}.json"
    if not path.is_file():
        raise FileNotFoundError(f"no site {str(name_or_path)!r}: give a file, or one of {', '.join(BUILT_IN)}")
    content = read_json(path)
    try:
        return parse(content)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def save_site(site: Site, path: str | Path) -> None:
    """Write a site as GeoJSON (local metres), to be read by `load_site` and by GIS tools."""
    write_text(path, dumps(site))
