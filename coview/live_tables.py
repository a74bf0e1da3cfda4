"""HTML of the live planner's panel: the hint, figures, notes and the table of variants. Names are
escaped."""

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from placement_env.handover.mounted import describe_radio, is_named_by_pole
from toolkit.display import describe_count, format_share
from toolkit.plots.palette import BAR, FAINT, GROUND, INK, OUTCOME, SOLID, sensor_colour

if TYPE_CHECKING:
    from placement_env.live.figures import FoundShare, LiveAnswer
    from placement_env.live.suggestions import Suggestion
    from placement_env.live.variant import Variant, Yard
    from placement_env.report.planning.plan_folder import StatedFigure
    from toolkit.sensors.sensor import Sensor
    from toolkit.sites.site import Site

_BOX = f"font:12px/1.35 system-ui,sans-serif;color:{INK};padding:.2em .9em"
MAP_REACH_M = 25.0  # length (m) of a field of view on a small map
_SMALL = f"color:{FAINT};font-size:12px"
_WIDE_SHEET = (  # on a telephone viser's sheet is 20em wide, ours is as wide as the screen
    '<style>[style*="fixed"][style*="20em"],[style*="fixed"] '
    '[style*="20em"]{width:100%!important}</style>'
)
_STEPS = (
    "<b>1</b> Drag a ball to turn a sensor, its box to another pole (Shift: up, down). <b>2</b> "
    "Read what it does. <b>3</b> Ask what is best, and accept it."
)
_FIRST_STEPS = (
    "<b>No sensor is here yet.</b> Ask for the best to add, and accept it; or choose a pole and "
    "Add on the tab Sensor; or add one at a click on the tab Draw. Poles that may be used have a "
    "cross on top."
)
START = (
    f'<div style="{_BOX}"><b>Open an OpenStreetMap (.osm) or OpenDRIVE (.xodr) extract, '
    "or a site</b>, by its path or as an upload. The junction around the centre becomes a site, "
    "and planning starts.</div>"
)
MAP_KEY = (
    f'<div style="{_BOX}"><div style="height:8px;'
    'background:linear-gradient(90deg,#fde725,#21918c,#440154)"></div>'
    '<div style="display:flex;justify-content:space-between">'
    "<span>never seen</span><span>always</span></div>"
    f'Boxes: <b style="color:{OUTCOME["hit"].colour}">found</b>, '
    f'<b style="color:{OUTCOME["missed"].colour}">missed, with a cross</b>, '
    "<b>under an arrow where no sensor sees them</b></div>"
)


def hint_html(sensors: int) -> str:
    """HTML of a hint on what to do first. sensors: number of sensors of the variant.

    Without sensors the hint is to add one."""
    steps = _STEPS if sensors else _FIRST_STEPS
    return (
        f'{_WIDE_SHEET}<div style="{_BOX};background:#eef2fe;border-radius:6px;margin:.3em '
        f'.6em">{steps}</div>'
    )


def figures_html(answer: "LiveAnswer") -> str:
    """HTML of an answer's figures, each with unit, interval and number of road users.

    They are the change since the answer before (if any), the AP, problems, costs, and the share
    found by class (if there are several) and by approach."""
    has_budget = np.isfinite(answer.budget)
    last_amount = answer.budget if has_budget else answer.price  # the unit comes after it
    unit = escape(answer.currency) or ("pole" if last_amount == 1 else "poles")
    worst = "no sensor is left"
    if answer.worst_sensor:
        bounds = _format_interval(answer.worst_low, answer.worst_high, answer.objects)
        interval = f" ({bounds})" if np.isfinite(answer.worst_low) else ""
        worst = (
            f"{format_share(answer.worst, answer.objects)}{interval} without "
            f"{escape(answer.worst_sensor)}"
        )
    budget = f" of {answer.budget:,.10g}" if has_budget else ""
    sensors = describe_count(answer.sensors, "sensor")
    # name and HTML of the figure in each row
    figures = (
        ("Worst failure leaves AP", f'<span class="live-worst">{worst}</span>'),
        ("Data", f'<span class="live-kbit">{answer.kbit:,.0f}</span> kbit per frame'),
        (
            "Price",
            f'<span class="live-price">{answer.price:,.10g}</span>{budget} {unit}, {sensors}',
        ),
        ("Seen by no sensor", f"{answer.unseen} of {describe_count(answer.objects, 'road user')}"),
        ("Fullest link", _describe_fullest_link(answer)),
        ("Radio", describe_radio(answer.links)),
    )
    rows = "".join(
        f'<tr><td style="{_SMALL}">{name}</td><td align="right">{text}</td></tr>'
        for name, text in figures
    )
    problems = "".join(
        f'<div style="color:{OUTCOME["missed"].colour}">&#9888; {escape(problem)}</div>'
        for problem in answer.problems
    )
    class_bars = ""
    if len(answer.classes) > 1:
        class_bars = _bars_html("Found, by class (95 % interval)", answer.classes)
    error = f"{answer.spread:.3f}" if np.isfinite(answer.spread) else "unknown"
    return (
        f'<div style="{_BOX}"><span class="live-ap" style="font-size:28px;font-weight:700">'
        f"{format_ap(answer)}</span> "
        f"AP, predicted{' (refining)' if answer.coarse else ''}"
        f'<div style="{_SMALL}">95 %: {_format_interval(answer.low, answer.high, answer.objects)}; '
        f"{_describe_counts(answer)}; "
        f"standard error of the prediction: {error}. AP, average precision, is 1 where every road "
        f"user is found and nothing else is.</div>{_change_html(answer)}{problems}"
        f'<table style="width:100%">{rows}</table>{class_bars}'
        f"{_bars_html('Found, by approach (95 % interval)', answer.approaches)}</div>"
    )


def _change_html(answer: "LiveAnswer") -> str:
    """HTML of the change of AP since the answer before, "" without one."""
    if not answer.change:
        return ""
    colour = OUTCOME["hit"].colour if answer.change > 0 else OUTCOME["missed"].colour
    bounds = _format_interval(answer.change_low, answer.change_high, answer.objects, signed=True)
    interval = f" ({bounds})" if np.isfinite(answer.change_low) else ""
    figure = format_share(answer.change, answer.objects, signed=True)
    return (
        f'<div style="color:{colour}"><b class="live-change">{figure}</b>{interval} '
        f"{escape(answer.what)}</div>"
    )


def details_html(answer: "LiveAnswer") -> str:
    """HTML of the share found at each level of traffic, and of the load of each link."""
    rows = "".join(
        f'<tr><td>{escape(link.pole)}</td><td align="right">{link.mbit_s:.1f}, '
        f"load {link.load_mbit_s:.1f} of {link.capacity_mbit_s:g} Mbit/s</td></tr>"
        for link in answer.links
    )
    frames = describe_count(answer.frames, "frame")
    links = f'<div style="{_SMALL};margin-top:.4em">Links, over {frames}</div><table>{rows}</table>'
    levels = _bars_html("Found, by traffic (95 % interval)", answer.levels)
    return f'<div style="{_BOX}">{levels}{links}</div>'


def _describe_counts(answer: "LiveAnswer") -> str:
    """Words for the numbers of road users and frames behind an answer."""
    return (
        f"N = {describe_count(answer.objects, 'road user')}, "
        f"{describe_count(answer.frames, 'frame')}"
    )


def _describe_fullest_link(answer: "LiveAnswer") -> str:
    """HTML of the link that is used to the greatest share of its capacity."""
    if not answer.links:
        return "none"
    link = max(answer.links, key=lambda load: load.share)
    return f"{link.share:.0%} of {link.capacity_mbit_s:g} Mbit/s, {escape(link.pole)}"


def _bars_html(title: str, rows: "Iterable[FoundShare]") -> str:
    """HTML of a titled list of groups of road users, each with a bar for its share found.

    rows: groups, such as classes or approaches."""
    lines = []
    for row in rows:
        has_objects = not np.isnan(row.recall)
        # % of the line
        bar_width = 100 * row.recall if has_objects else 0.0
        bar = f'<div style="background:{BAR};height:6px;width:{bar_width:.0f}%"></div>'
        share = f"{row.recall:.0%}" if has_objects else "none there"
        interval = ""
        if np.isfinite(row.low) and row.ap is None:  # with an AP the interval is the AP's
            interval = f" ({row.low:.0%} to {row.high:.0%})"
        ap = ""
        if row.ap is not None and not np.isnan(row.ap):
            ap = (
                f", AP {format_share(row.ap, row.objects)} "
                f"({_format_interval(row.low, row.high, row.objects)})"
            )
        lines.append(
            "<div "
            'style="display:flex;flex-wrap:wrap;justify-content:space-between;column-gap:.8em;'
            'margin-top:.25em">'
            f'<span style="overflow-wrap:anywhere">{escape(row.name)}</span><span '
            f'style="{_SMALL}">{share}{interval}{ap}, N = {row.objects}</span></div><div '
            f'style="background:#e3e3e6">{bar}</div>'
        )
    heading = f'<div style="{_SMALL};margin-top:.4em">{escape(title)}</div>'
    return heading + "".join(lines)


def note_html(busy: str, note: str) -> str:
    """HTML of the line on work in progress, and of the note below it; "" leaves either out."""
    lines = [f"<i>{escape(busy)} &#8230;</i>"] if busy else []
    lines += [f'<span class="live-note">{escape(note)}</span>'] if note else []
    return f'<div style="{_BOX};min-height:1.4em">{"<br>".join(lines)}</div>'


def site_html(site: "Site") -> str:
    """HTML of streets and buildings from above, hidden, which every `map_html` shows again."""
    outlines = [(lane, GROUND["lanes"]) for lane in site.lanes]  # corners and colour
    for solid in site.solids:
        if solid.kind in ("building", "pond"):
            outlines.append((solid.footprint, SOLID[solid.kind]))
    shapes = "".join(
        f'<path d="{_svg_path(corners)}" fill="{colour}"/>' for corners, colour in outlines
    )
    return (
        f'<svg width="0" height="0" style="position:absolute"><g id="live-site">{shapes}</g></svg>'
    )


def map_html(site: "Site", sensors: "Iterable[tuple[Sensor, bool]]") -> str:
    """HTML of a small map of sensors, each with its field of view, with the site's y axis upwards.

    sensors: pairs of a sensor and True if it has failed, which makes it faint."""
    xmin, ymin, xmax, ymax = site.area.tolist()
    shapes = []
    for index, (sensor, has_failed) in enumerate(sensors):
        x, y, _ = sensor.position.tolist()
        half_angle = min(sensor.model.horizontal_fov / 2, np.pi)
        # the sensor's x axis, in the site's frame
        ahead_x, ahead_y = sensor.world_SE3_body[:2, 0]
        # nine headings (rad from the site's x axis) approximate the arc
        headings = np.arctan2(ahead_y, ahead_x) + np.linspace(-half_angle, half_angle, 9)
        arc = np.column_stack(
            [x + MAP_REACH_M * np.cos(headings), y + MAP_REACH_M * np.sin(headings)]
        )
        sector = [(x, y), *arc.tolist()]  # field of view from above
        colour = FAINT if has_failed else sensor_colour(index)
        shapes.append(
            f'<path d="{_svg_path(sector)}" fill="{colour}" fill-opacity=".35"/>'
            f'<circle cx="{x:.1f}" cy="{-y:.1f}" r="2.5" fill="{colour}"/>'
        )
    # left, top, width and height of the area; SVG's y axis goes down
    box = f"{xmin:.1f} {-ymax:.1f} {xmax - xmin:.1f} {ymax - ymin:.1f}"
    return (
        f'<svg viewBox="{box}" style="width:84px;display:block"><use '
        f'href="#live-site"/>{"".join(shapes)}</svg>'
    )


def draw_small_maps(
    yard: "Yard", variants: "Iterable[Variant]", drawn_maps: "Mapping[Variant, str]"
) -> dict["Variant", str]:
    """HTML of a small map of each variant, by variant.

    yard: site, with its stock of poles and models, from which sensors are built; drawn_maps: maps
    that are drawn already, used again."""
    maps = {}
    for variant in variants:
        sensors = [
            (yard.build_sensor(variant, live_sensor), live_sensor.failed)
            for live_sensor in variant.sensors
        ]
        maps[variant] = drawn_maps.get(variant) or map_html(yard.site, sensors)
    return maps


def _svg_path(corners: Iterable[Iterable[float]]) -> str:
    """Closed path in SVG around corners (x, y in m); SVG's y axis goes down."""
    return f"M{' '.join(f'{x:.1f},{-y:.1f}' for x, y in corners)}Z"


def variants_html(
    answers: "Mapping[str, LiveAnswer]", current: str, maps: Mapping[str, str]
) -> str:
    """HTML of the table of variants, a row each, with small maps and figures.

    answers: figures by name of the variant; current: name of the one that is shown, printed bold;
    maps: HTML of the small map by name."""
    rows = []
    for name, answer in answers.items():
        weight = "700" if name == current else "400"
        aps = (
            (answer.ap, answer.low, answer.high),
            (answer.worst, answer.worst_low, answer.worst_high),
        )
        cells = [
            (
                f"{format_share(ap, answer.objects)}<br><span "
                f"style='{_SMALL}'>{_format_interval(low, high, answer.objects)}</span>"
            )
            for ap, low, high in aps
        ]
        cells += [f"{answer.kbit:,.0f}", f"{answer.price:,.10g}"]
        figures = "".join(f'<td align="right">{cell}</td>' for cell in cells)
        rows.append(
            '<tr class="live-variant" '
            f'style="font-weight:{weight}"><td>{escape(name)}{maps[name]}</td>{figures}</tr>'
        )
    current_answer = answers[current]
    titles = (
        "AP (95&nbsp;%)",
        "AP, worst failure",
        "kbit per frame",
        f"price, {escape(current_answer.currency) or 'poles'}",
    )
    head = "".join(f'<td align="right">{title}</td>' for title in titles)
    table = (
        '<table style="width:100%"><tr '
        f'style="{_SMALL}"><td></td>{head}</tr>{"".join(rows)}</table>'
    )
    table += f'<div style="{_SMALL}">{_describe_counts(current_answer)}</div>'
    return f'<div style="{_BOX}">{table}</div>'


def format_ap(answer: "LiveAnswer | StatedFigure") -> str:
    """Text of an AP, with the decimals that its number of road users supports."""
    return format_share(answer.ap, answer.objects)


def describe_ap(answer: "LiveAnswer") -> str:
    """Text of an AP with its 95 % interval."""
    return f"AP {format_ap(answer)} ({_format_interval(answer.low, answer.high, answer.objects)})"


def describe_stated(stated: "StatedFigure") -> str:
    """Text on the AP that the opened plan states, measured by its detector."""
    return f"AP {format_ap(stated)} is what the plan states, by its detector; the page predicts"


def describe_suggestions(kind: str, suggestions: "Sequence[Suggestion]") -> str:
    """Text on suggestions of one kind, the best first. kind: "add", "move" or "remove"."""
    descriptions = []
    for suggestion in suggestions:
        sensor = suggestion.sensor.name
        pole = suggestion.sensor.mount
        place = sensor if is_named_by_pole(sensor, pole) else f"{sensor} on {pole}"
        descriptions.append(f"{place}: {describe_ap(suggestion.answer)}")
    title = {"add": "next sensor", "move": "best place", "remove": "missed least"}[kind]
    text = "; ".join(descriptions)
    if kind == "remove":
        return f"{title}: {text or 'none'}"
    if not suggestions:
        return f"{title}: none among the poles looked at so far; ask again"
    return f"{title}: {text} (of {suggestions[0].considered} placements so far)"


def _format_interval(low: float, high: float, object_count: int, *, signed: bool = False) -> str:
    """Text of an interval, with the decimals that the number of road users supports.

    signed: True to print + before ends above 0."""
    if not (np.isfinite(low) and np.isfinite(high)):
        return "no interval from few frames"
    return " to ".join(format_share(end, object_count, signed=signed) for end in (low, high))
