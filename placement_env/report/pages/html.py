"""A document as one page of HTML that works from disk: styles, script, drawings and the 3D scene are all inside.

A policy in the page itself forbids every request to anywhere. The scene waits as data until the reader comes near it.
"""

from __future__ import annotations

from base64 import b64encode
from pathlib import Path

from placement_env.report.pages.document import Document
from placement_env.report.pages.scene import Scene
from toolkit.viewing.scene import POLICY, scene_script, script_data

_FOLDER = Path(__file__).parent


def html_of(document: Document, scene: Scene | None) -> str:
    """The page; without a scene it says where the scene would stand that there is nothing to show."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    environment = Environment(
        loader=FileSystemLoader(_FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page: str = environment.get_template("report.html.j2").render(
        document=document,
        policy=POLICY,
        style=Markup((_FOLDER / "report.css").read_text(encoding="utf-8")),
        script=Markup((_FOLDER / "report.js").read_text(encoding="utf-8") + scene_script()),
        layers=scene.layers if scene else (),
        frames=scene.frames if scene else (),
        scene_data=Markup(script_data({"html": scene.html, "frames": scene.frames})) if scene else None,
        picture=_picture,
    )
    return page


def _picture(svg: str) -> str:
    """A drawing as the address of an image, in which no script runs and no name meets another drawing's."""
    return "data:image/svg+xml;base64," + b64encode(svg.encode("utf-8")).decode("ascii")
