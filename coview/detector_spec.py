"""`DetectorSpec`: the parsed name of a detector, as --detector takes it.

A name may end in these suffixes, in any order:

    +background   a detector that knows the empty site and leaves out what is always there.
                  `general` has it at a site with known scenery, `general-background` has not.
                  For `general`, `coview detect` learns what is in most frames if the site is
                  unknown and the sensors do not move. If nothing is known about the site,
                  `general` reports pedestrians from a higher score on
    +phases4      a network on four shifted grids, whose boxes are averaged
    +bfloat16     a network in coarser numbers, in half the time, if the processor has
                  instructions for them; `coview detect` adds it unless +float32 is given"""

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

GENERAL = "general"
CLUSTER = "cluster"
VOXELNET = "voxelnet"  # the network shipped for the site
_BACKGROUND = "+background"
_NO_BACKGROUND = "-background"
_BFLOAT16 = "+bfloat16"
_FLOAT32 = "+float32"
_SUFFIXES = re.compile(r"(.+?)((?:\+background|-background|\+phases\d{1,3}|\+bfloat16|\+float32)*)")

if TYPE_CHECKING:
    from toolkit.sites.site import Site


@dataclass(frozen=True)
class DetectorSpec:
    """Parsed name of a detector.

    Attributes:
        name: Name with its suffixes.
        base: Name without suffixes: voxelnet, cluster, a shipped network, a file of weights or in
            ONNX, or package.module:callable.
        background: True if it knows the empty site and leaves out what is always there, None for
            the usual behaviour of the name.
        phases: Number of shifted grids whose boxes are averaged, 1 for none.
        numbers: Type of the network's numbers, None for the type of its weights.
    """

    name: str
    base: str
    background: bool | None = None
    phases: int = 1
    numbers: Literal["bfloat16", "float32"] | None = None

    @staticmethod
    def from_name(name: str) -> "DetectorSpec":
        """Parse a detector's name; text that is no known suffix belongs to the base.

        Suffixes may ask for background subtraction, test-time shifts of the grid (phases) and
        number formats."""
        match = _SUFFIXES.fullmatch(name)
        base, suffixes = match.groups() if match else (name, "")
        background = None
        # each suffix has one + or -, at its beginning, so `in` finds none inside another one
        if _BACKGROUND in suffixes:
            background = True
        elif _NO_BACKGROUND in suffixes:
            background = False
        numbers: Literal["bfloat16", "float32"] | None = None
        if _FLOAT32 in suffixes:
            numbers = "float32"
        elif _BFLOAT16 in suffixes:
            numbers = "bfloat16"
        phases = re.search(r"phases(\d+)", suffixes)
        return DetectorSpec(
            name,
            base=base,
            background=background,
            phases=int(phases[1]) if phases else 1,
            numbers=numbers,
        )

    @property
    def is_imported(self) -> bool:
        """True for a Python object, package.module:callable."""
        return ":" in self.base

    @property
    def is_onnx(self) -> bool:
        """True for a file in ONNX."""
        return self.base.endswith(".onnx")

    @property
    def needs_site(self) -> bool:
        """True for a detector that exists only at a known site or in a recording."""
        return self.base in (VOXELNET, CLUSTER)

    @property
    def learns_scene(self) -> bool:
        """True if it learns, by default, what is always there at an unknown site."""
        return self.base == GENERAL and self.background is None

    def knows_background(self, site: "Site | None" = None) -> bool:
        """True if it leaves out what is always there. site: site of detection, None if unknown."""
        has_scenery = site is not None and len(site.solids) > 0
        return bool(self.background) or (self.learns_scene and has_scenery)

    def without_background(self) -> "DetectorSpec":
        """Same detector that leaves nothing out."""
        name = self.name.replace(_BACKGROUND, _NO_BACKGROUND)
        return replace(self, name=name, background=False)

    def in_bfloat16(self) -> "DetectorSpec":
        """Same detector in coarser numbers, unless its name asks for exact ones."""
        return replace(self, name=self.name + _BFLOAT16, numbers=self.numbers or "bfloat16")

    def without_suffixes(self) -> "DetectorSpec":
        """Same detector as it is usual."""
        return DetectorSpec(self.base, self.base)
