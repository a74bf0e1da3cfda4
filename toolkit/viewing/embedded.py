"""A scene of viser inside another page: the policy of that page, data in its script, and the script of its switches.

A policy in the page itself forbids every request to anywhere. The scene waits as data until the reader comes near it.
"""

from __future__ import annotations

import json
from pathlib import Path

POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' blob: data:; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; connect-src data: blob:; worker-src blob: data:; "
    "frame-src 'self' blob: data:; media-src data:; form-action 'none'; base-uri 'none'"
)


def scene_script() -> str:
    """The script that loads a scene into its frame and switches its nodes: of every `input` with data-node, which names
    one node or several, and of every frame of the recording, of which one is shown."""
    return (Path(__file__).parent / "scene.js").read_text(encoding="utf-8")


def script_data(value: object) -> str:
    """JSON that may stand inside a script element, whatever its texts hold.

    >>> script_data("</script>")
    '"\\\\u003c/script>"'
    """
    return json.dumps(value).replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
