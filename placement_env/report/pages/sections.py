"""The report of a plan as a document: its sections in the order in which a reader needs them."""

from __future__ import annotations

from placement_env.fidelity.combined.mean_iou import iou_text
from placement_env.report.content import Ground, Plan
from placement_env.report.pages.document import Document
from placement_env.report.pages.sections_answer import (
    alternatives_section,
    chosen_section,
    front_section,
    requirement_section,
)
from placement_env.report.pages.sections_building import links_section, materials_section, schedule_section
from placement_env.report.pages.sections_detection import detection_section, schemes_section
from placement_env.report.pages.sections_ground import ground_section
from placement_env.report.pages.sections_method import method_section
from placement_env.report.pages.sections_resilience import failures_section, order_section, worth_section
from toolkit.sites.site import Site


def report_of(plan: Plan, site: Site, ground: Ground | None) -> Document:
    """The document. site: with the chosen sensors mounted; ground: what they see of it, None without any."""
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
