"""Names and letters that the fonts of a report can set, and sensors named by their poles."""

import re
import warnings
from dataclasses import fields, is_dataclass, replace

from placement_env.handover.mounted import name_by_poles
from placement_env.report import content
from placement_env.report.pages.document import Document, PageDrawing, Paragraph
from toolkit.plots.fonts import (
    UNSET,
    choose_fonts,
    name_letters,
    number_names,
    own_font,
    replace_letters,
    spell_name,
)
from toolkit.sites.site import Site

PAPER_FONT = "DejaVuSansMono"  # a font of typst for letters that its main font lacks


def list_texts(value: object) -> list[str]:
    """List all texts of a document, or of a part, that fonts must set.

    A drawing gives its caption and its text for screen readers, not its SVG.

    value: dataclass, tuple, text, or anything else, which has none."""
    if isinstance(value, str):
        return [value]
    if isinstance(value, PageDrawing):
        return [value.caption, value.alt]
    if isinstance(value, tuple):
        return [text for item in value for text in list_texts(item)]
    if is_dataclass(value):
        return [text for field in fields(value) for text in list_texts(getattr(value, field.name))]
    return []


def settle_names(plan: content.Plan, site: Site) -> tuple[content.Plan, Site, str]:
    """Number the poles and sensors whose names hold letters that no font here can set.

    Such names become "pole 3" or "sensor 1", for example, in the report, with a warning. Returns
    the plan with numbers in all its texts, the site, and a note, empty without numbers."""
    poles = [mount.name for mount in site.mounts]
    poles += [sensor.pole for sensor in plan.sensors]
    poles += plan.poles_unused
    sensors = [sensor.name for sensor in site.sensors]
    sensors += [sensor.name for sensor in plan.sensors]
    unset_letters = choose_fonts([*poles, *sensors], own_font(PAPER_FONT)).unset
    numbers = number_names(tuple(dict.fromkeys(sensors)), unset_letters, "sensor")
    numbers |= number_names(tuple(dict.fromkeys(poles)), unset_letters, "pole")
    if not numbers:
        return plan, site, ""
    longest_first = "|".join(map(re.escape, sorted(numbers, key=len, reverse=True)))

    def number_all(text: str) -> str:
        return re.sub(longest_first, lambda match: numbers[match[0]], text)

    mounts = tuple(replace(mount, name=number_all(mount.name)) for mount in site.mounts)
    renamed_sensors = tuple(
        replace(sensor, name=number_all(sensor.name)) for sensor in site.sensors
    )
    listed_names = "; ".join(
        f"{number} is {spell_name(name, unset_letters)}" for name, number in numbers.items()
    )
    note = f"Names with letters that no font here can set are numbered: {listed_names}."
    letters = "".join(sorted(unset_letters))
    number_texts = ", ".join(f"{name!r} is {number}" for name, number in numbers.items())
    remedy = "install a font that has them, such as Noto Sans"
    warnings.warn(
        f"no font here can set the letters {letters}, so in the report {number_texts}: {remedy}",
        stacklevel=3,
    )
    numbered_plan = content.replace_texts(plan, number_all)
    return numbered_plan, replace(site, mounts=mounts, sensors=renamed_sensors), note


def drop_unset(document: Document) -> Document:
    """Return the document with a mark in place of letters that no font here can set.

    If there are any, a warning is given, and a note is added to the first section."""
    unset_letters = choose_fonts(list_texts(document), own_font(PAPER_FONT)).unset
    if not unset_letters:
        return document
    letters = "".join(sorted(unset_letters))
    warnings.warn(
        f"no font here can set the letters {letters}, which the report shows as {UNSET}",
        stacklevel=3,
    )
    first_section = document.sections[0]
    codes = name_letters(unset_letters)
    note = Paragraph(
        f"No font here can set {codes}: {UNSET} stands for them. Install one that can, such as "
        "Noto Sans."
    )
    noted_section = replace(first_section, blocks=(*first_section.blocks, note))
    sections = (noted_section, *document.sections[1:])
    # the logo is data, in which no letter may be replaced, so it is put back afterwards
    without_logo = replace(document, sections=sections, logo="")
    printable = content.replace_texts(
        without_logo, lambda text: replace_letters(text, unset_letters)
    )
    return replace(printable, logo=document.logo)


def use_pole_names(plan: content.Plan) -> content.Plan:
    """Return a plan that names all sensors of a pool by their poles, in all its texts.

    Candidates have long names of pole and pose. Chosen sensors have short names already; other
    sensors on the same poles are marked "(other aim)"."""
    chosen_names = {sensor.name for sensor in plan.sensors}
    used_poles = {sensor.pole for sensor in plan.sensors}
    pole_of_sensor: dict[str, str] = {}
    for option in plan.considered:
        pole_of_sensor |= zip(option.sensors, option.poles, strict=False)
    new_names = {}
    for name, pole in pole_of_sensor.items():
        (short_name,) = name_by_poles([name], [pole])
        if name in chosen_names or short_name == name:
            continue
        new_names[name] = f"{short_name} (other aim)" if pole in used_poles else short_name
    return content.rename(plan, new_names)
