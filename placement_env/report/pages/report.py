"""The report of a plan, as report.html and report.pdf. Its sections come in the order in which a reader needs them."""

from __future__ import annotations

from pathlib import Path

from placement_env.cases import iou_text
from placement_env.handover.ground import Ground
from placement_env.report.content import Plan, Planned
from placement_env.report.pages.document import Document, to_html, to_pdf
from placement_env.report.pages.performance import (
    detection_section,
    failures_section,
    ground_section,
    order_section,
    schemes_section,
    worth_section,
)
from placement_env.report.pages.recommendation import (
    alternatives_section,
    chosen_section,
    front_section,
    links_section,
    materials_section,
    method_section,
    requirement_section,
    schedule_section,
)
from placement_env.report.pages.scene import build_scene
from toolkit.runtime.files import writing_together
from toolkit.sites.site import Site

REPORT_FILES = ("report.html", "report.pdf")


def build_document(plan: Plan, site: Site, ground: Ground | None) -> Document:
    """Build the document. site: with the chosen sensors mounted; ground: that they see, None if unknown."""
    sections = (
        requirement_section(plan),
        chosen_section(plan, site, ground),
        ground_section(plan, site, ground),
        detection_section(plan),
        schemes_section(plan),
        front_section(plan),
        worth_section(plan),
        failures_section(plan),
        links_section(plan),
        materials_section(plan),
        schedule_section(plan),
        order_section(plan),
        alternatives_section(plan),
        method_section(plan),
    )
    subtitle = (
        f"{plan.detector}; AP at IoU {iou_text(plan.iou)}; {plan.scheme} fusion"
        if plan.detector
        else "No set was judged"
    )
    return Document(f"Deployment plan for {plan.site}", subtitle, sections)


def write_report(planned: Planned, out: Path) -> None:
    """Write `REPORT_FILES` into a folder, made if missing.

    Writes both or neither; the same plan gives the same bytes.

    Raises ImportError without the packages of `coview[report]`, OSError if the folder cannot be written.
    """
    plan, site, ground = planned.plan, planned.site, planned.ground
    document = build_document(plan, site, ground)
    scene = None if plan.chosen is None else build_scene(plan, site, ground, planned.moments)
    with writing_together(out) as folder:
        (folder / "report.html").write_text(to_html(document, scene), encoding="utf-8")
        (folder / "report.pdf").write_bytes(to_pdf(document))
