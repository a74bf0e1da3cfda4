"""Pages around a scene, from a template."""

import json
from pathlib import Path

from toolkit.viewing.scene import FOLDER

# content security policy: a page loads nothing from the network, and runs only what it contains
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval' blob: data:; style-src "
    "'unsafe-inline'; img-src data: blob:; font-src data:; connect-src data: blob:; worker-src "
    "blob: data:; frame-src 'self' blob: data:; media-src data:; form-action 'none'; base-uri "
    "'none'"
)


def render_page(template: Path, data: object, script: str = "", **values: object) -> str:
    """Render a page of HTML around a scene.

    template: file of the jinja2 template; data: data of the scene, put as JSON into a script
    element, None without a scene; script: JavaScript that precedes the script of the scene; values:
    other variables of the template. Raises ImportError without jinja2."""
    try:
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    except ImportError:
        raise ImportError("pages need jinja2: pip install coview[report]") from None

    environment = Environment(
        loader=FileSystemLoader(template.parent), autoescape=True, undefined=StrictUndefined
    )
    environment.trim_blocks = environment.lstrip_blocks = True
    scene_values = {"policy": POLICY, "scene_data": None if data is None else script_data(data)}
    script += (FOLDER / "scene.js").read_text(encoding="utf-8")
    return environment.get_template(template.name).render(**scene_values, script=script, **values)


def script_data(value: object) -> str:
    r"""JSON that is safe inside a script element of HTML, whatever its texts hold."""
    # "<" could end the element; the two separators end a line in JavaScript, but not in JSON
    return (
        json.dumps(value)
        .replace("<", "\\u003c")
        .replace("\u2028", "\\u2028")
        .replace("\u2029", "\\u2029")
    )
