"""`Layer`: a part of the 3D scene with a switch on the page."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Layer:
    """A part of the scene that readers may hide.

    Attributes:
        name: Name for the switch.
        node: Path of its node in viser's tree; hiding it hides all nodes below.
        colour: Colour of the switch and the part.
        mark: Drawing style in words, such as "dashed boxes"."""

    name: str
    node: str
    colour: str
    mark: str
