"""The report of a plan, as report.html and report.pdf. Its sections come in the order in which a reader needs them."""

from __future__ import annotations

from pathlib import Path

from placement_env.cases import iou_text
from placement_env.handover.ground import Ground
from placement_env.report.content import Plan, Planned
from placement_env.report.pages import performance, recommendation
from placement_env.report.pages.document import Document, Section, say, to_html, to_pdf
from placement_env.report.pages.scene import build_scene
from toolkit.runtime.files import writing_together
from toolkit.sites.site import Site

REPORT_FILES = ("report.html", "report.pdf")
TITLES = {
    "requirement": "Is the requirement met?",
    "chosen": "The chosen set, and why",
    "ground": "What the sensors see of the ground",
    "detection": "How well vehicles are detected, and where",
    "schemes": "Sending points or sending detections",
    "front": "What more money or faster links buy",
    "worth": "What each sensor is worth",
    "failures": "What is left when sensors fail",
    "links": "What the links carry",
    "materials": "Bill of materials",
    "schedule": "Mounting schedule",
    "order": "Which sensor to build first",
    "alternatives": "Sets that are nearly as good",
    "method": "How this was worked out",
}
NOTHING_CHOSEN = "No set of sensors may be built, so there is nothing to show here."


def build_document(plan: Plan, site: Site, ground: Ground | None) -> Document:
    """Build the document. site: with the chosen sensors mounted; ground: that they see, None if unknown."""
    content = dict.fromkeys(TITLES, say(NOTHING_CHOSEN))
    content["requirement"] = recommendation.requirement_section(plan)
    content["ground"] = performance.ground_section(plan, site, ground)
    content["method"] = recommendation.method_section(plan)
    if plan.chosen is not None:
        content |= {
            "chosen": recommendation.chosen_section(plan, plan.chosen, site, ground),
            "detection": performance.detection_section(plan),
            "schemes": performance.schemes_section(plan),
            "front": recommendation.front_section(plan, plan.chosen),
            "worth": performance.worth_section(plan),
            "failures": performance.failures_section(plan, plan.chosen),
            "links": recommendation.links_section(plan),
            "materials": recommendation.materials_section(plan),
            "schedule": recommendation.schedule_section(plan),
            "order": performance.order_section(plan),
            "alternatives": recommendation.alternatives_section(plan, plan.chosen),
        }
    titles = TITLES | ({"requirement": "The answer"} if plan.verdict.met is None else {})
    sections = tuple(Section(key, title, *content[key]) for key, title in titles.items())
    judged = f"{plan.detector}; AP at IoU {iou_text(plan.iou)}; {plan.scheme} fusion"
    return Document(f"Deployment plan for {plan.site}", judged if plan.detector else "No set was judged", sections)


def write_report(planned: Planned, out: Path) -> None:
    """Write `REPORT_FILES` into a folder, made if missing. Both are written or neither, with the same bytes each time.

    Raises ImportError without the packages of `coview[report]`, OSError if the folder cannot be written.
    """
    plan, site, ground = planned.plan, planned.site, planned.ground
    document = build_document(plan, site, ground)
    scene = None if plan.chosen is None else build_scene(plan, site, ground, planned.moments)
    with writing_together(out) as folder:
        (folder / "report.html").write_text(to_html(document, scene), encoding="utf-8")
        (folder / "report.pdf").write_bytes(to_pdf(document))
