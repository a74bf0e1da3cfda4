"""The files of a report: report.html and report.pdf, both or neither."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, runtime_checkable

from placement_env.report.content import Ground, Moment, Plan
from placement_env.report.pages.html import html_of
from placement_env.report.pages.pdf import pdf_of
from placement_env.report.pages.scene import build_scene
from placement_env.report.pages.sections import report_of
from toolkit.runtime.files import writing_together
from toolkit.sites.site import Site

REPORT_FILES = ("report.html", "report.pdf")


@runtime_checkable
class PlanWithGround(Protocol):
    """A plan with what its pages are made from. site: with the chosen sensors mounted; ground: what they see of it."""

    @property
    def plan(self) -> Plan:
        """What it says."""
        ...

    @property
    def site(self) -> Site:
        """With the chosen sensors mounted."""
        ...

    @property
    def ground(self) -> Ground | None:
        """What they see of it, None without any."""
        ...

    @property
    def moments(self) -> tuple[Moment, ...]:
        """Frames for the scene."""
        ...


def write_report(planned: PlanWithGround, out: Path) -> None:
    """Write report.html and report.pdf into the folder `out`, made if missing. The same plan gives the same files.

    Raises ImportError without the packages of `coview[report]`, OSError where the folder cannot be written.
    """
    plan, site, ground = planned.plan, planned.site, planned.ground
    document = report_of(plan, site, ground)
    scene = None if plan.chosen is None else build_scene(plan, site, ground, planned.moments)
    with writing_together(out) as folder:
        (folder / "report.html").write_text(html_of(document, scene), encoding="utf-8")
        (folder / "report.pdf").write_bytes(pdf_of(document))
