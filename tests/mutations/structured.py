"""Damage that knows its format: what people, converters and attackers do to a file that still
parses.

Units, swapped axes, doubled, misspelt and missing keys, huge counts, aliases, links, deep nesting,
times that go back, long names, and files of a few kilobytes that unpack to gigabytes. Mutations are
those of `mutants`: the content of a sound file and a generator in, what was done and the damaged
content out.
"""

import io
import json
import re
import struct
import zipfile
from collections.abc import Callable
from typing import Any

import h5py
import numpy as np
from mutants import Mutation

Rng = np.random.Generator
FACTORS = (1e3, 1e-3, 1e6, 1e9, -1.0, 0.0)
COUNTS = (10**6, 10**9, 2**31, 2**32 - 1, 2**63, -1)
NAMES = (
    "\x1b[2J\x1b]0;owned\x07",
    "car\u202egpj.exe",
    "../../../etc/passwd",
    "/etc/passwd",
    "=1+1",
    "x;=1+1",
    "N" * 10**6,
)
UNITS = ("mm", "cm", "m", "km", "ft", "deg", "parsec")
FRAMES = ("lidar", "map", "utm", "left")
OFFSET = "692000.5 5336000 -12"
TIMES = ("2026-11-23T20:00:00Z", 1.7e18, 1.7e15, 1.7e12, -5, "yesterday")


def pick(rng: Rng, some: Any) -> Any:
    return some[int(rng.integers(len(some)))]


# JSON

Place = tuple[Any, Any]  # a list or object, and the index or key within


def places(document: Any) -> list[Place]:
    """Every value in a JSON document."""
    found, waiting = [], [document]
    while waiting:
        holder = waiting.pop()
        keys = (
            list(holder)
            if isinstance(holder, dict)
            else range(len(holder))
            if isinstance(holder, list)
            else ()
        )
        for key in keys:
            found.append((holder, key))
            waiting.append(holder[key])
    return found


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def json_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    document = json.loads(content)
    every = places([document])
    changes: tuple[Callable[[Any, list[Place], Rng], str], ...] = (
        *(
            _scale,
            _scale,
            _swap,
            _count,
            _drop,
            _misspell,
            _repeat,
            _empty,
            _reverse,
            _rename,
            _comma,
            _time,
            _deepen,
        ),
        *(_share, _dangle, _back, _frame, _far, _turn),
    )
    what = pick(rng, changes)(document, every, rng)
    return what, json.dumps(document).encode()


def _some(every: list[Place], rng: Rng, kind: Callable[[Any], bool]) -> Place:
    suitable = [(holder, key) for holder, key in every if kind(holder[key])]
    return pick(rng, suitable or every)


def _alike(every: list[Place], key: Any) -> list[Place]:
    """The places of that key, or that place in every list of numbers."""
    return [(holder, k) for holder, k in every if k == key and is_number(holder[k])]


def _scale(document: Any, every: list[Place], rng: Rng) -> str:
    holder, key = _some(every, rng, is_number)
    factor = pick(rng, FACTORS)
    chosen = _alike(every, key) if rng.random() < 0.5 else [(holder, key)]
    for some, k in chosen:
        some[k] = some[k] * factor if is_number(some[k]) else some[k]
    return f"{len(chosen)} of {key!r} times {factor:g}"


def _swap(document: Any, every: list[Place], rng: Rng) -> str:
    _, key = _some(
        every, rng, lambda value: isinstance(value, list) and len(value) > 1 and is_number(value[0])
    )
    changed = 0
    for some, k in every:
        row = some[k]
        if k == key and isinstance(row, list) and len(row) > 1:
            row[0], row[1] = row[1], row[0]
            changed += 1
    return f"first two of {changed} {key!r} exchanged"


def _count(document: Any, every: list[Place], rng: Rng) -> str:
    holder, key = _some(
        every, rng, lambda value: isinstance(value, int) and not isinstance(value, bool)
    )
    holder[key] = pick(rng, COUNTS)
    return f"{key!r} is {holder[key]}"


def _drop(document: Any, every: list[Place], rng: Rng) -> str:
    key = pick(rng, [key for holder, key in every if isinstance(holder, dict)] or [0])
    for holder, k in every:
        if k == key and isinstance(holder, dict):
            holder.pop(k, None)
    return f"every {key!r} is gone"


def _misspell(document: Any, every: list[Place], rng: Rng) -> str:
    holder, key = pick(rng, [each for each in every if isinstance(each[0], dict)] or every)
    if isinstance(holder, dict):
        holder[key.swapcase() if rng.random() < 0.5 else f"{key}s"] = holder.pop(key)
    return f"{key!r} is misspelt"


def _repeat(document: Any, every: list[Place], rng: Rng) -> str:
    holder, key = _some(every, rng, lambda value: isinstance(value, list) and bool(value))
    times = (
        pick(rng, (2, 1000))
        if isinstance(holder[key], list) and len(json.dumps(holder[key])) < 3000
        else 2
    )
    holder[key] = holder[key] * times if isinstance(holder[key], list) else [holder[key]] * times
    return f"{key!r} is there {times} times"


def _empty(document: Any, every: list[Place], rng: Rng) -> str:
    holder, key = _some(every, rng, lambda value: isinstance(value, list | dict) and bool(value))
    holder[key] = type(holder[key])()
    return f"{key!r} is empty"


def _reverse(document: Any, every: list[Place], rng: Rng) -> str:
    holder, key = _some(every, rng, lambda value: isinstance(value, list) and len(value) > 1)
    holder[key] = holder[key][::-1] if isinstance(holder[key], list) else holder[key]
    return f"{key!r} runs back"


def _rename(document: Any, every: list[Place], rng: Rng) -> str:
    holder, key = _some(every, rng, lambda value: isinstance(value, str))
    holder[key] = pick(rng, NAMES)
    return f"{key!r} is {holder[key][:20]!r}"


def _comma(document: Any, every: list[Place], rng: Rng) -> str:
    _, key = _some(every, rng, is_number)
    for some, k in _alike(every, key):
        some[k] = f"{some[k]:.3f}".replace(".", ",")
    return f"{key!r} with decimal commas"


def _time(document: Any, every: list[Place], rng: Rng) -> str:
    stamps = [(h, k) for h, k in every if isinstance(k, str) and ("time" in k or "stamp" in k)]
    holder, key = pick(rng, stamps or every)
    holder[key] = pick(rng, TIMES)
    return f"{key!r} is {holder[key]!r}"


def _back(document: Any, every: list[Place], rng: Rng) -> str:
    """Times, or what else has the name of one, run back."""
    stamps = [(h, k) for h, k in every if isinstance(k, str) and ("time" in k or "stamp" in k)]
    values = [holder[key] for holder, key in stamps]
    for (holder, key), value in zip(stamps, values[::-1], strict=True):
        holder[key] = value
    return f"{len(stamps)} times run back"


def _deepen(document: Any, every: list[Place], rng: Rng) -> str:
    holder, key = pick(rng, every)
    depth, value = pick(rng, (50, 400)), holder[key]
    for _ in range(depth):
        value = [value]
    holder[key] = value
    return f"{key!r} within {depth} lists"


def _share(document: Any, every: list[Place], rng: Rng) -> str:
    """Two of a list are one and the same, tokens included."""
    holder, key = _some(every, rng, lambda value: isinstance(value, list) and len(value) > 1)
    if isinstance(holder[key], list) and len(holder[key]) > 1:
        holder[key][-1] = holder[key][0]
    return f"last of {key!r} is the first"


def _dangle(document: Any, every: list[Place], rng: Rng) -> str:
    tokens = [
        (h, k)
        for h, k in every
        if isinstance(k, str) and isinstance(h[k], str) and ("token" in k or "id" in k)
    ]
    holder, key = pick(rng, tokens or every)
    holder[key] = "0" * 32
    return f"{key!r} leads nowhere"


def _frame(document: Any, every: list[Place], rng: Rng) -> str:
    """A coordinate system is another one, unknown, or none."""
    words = ("coordinate_system", "frame", "parent", "src", "dst", "sensor")
    named = [(h, k) for h, k in every if isinstance(k, str) and k in words]
    holder, key = pick(rng, named or every)
    holder[key] = pick(rng, (*FRAMES, "", None, "world", "north"))
    return f"{key!r} is {holder[key]!r}"


def _far(document: Any, every: list[Place], rng: Rng) -> str:
    """Places are counted from the origin of UTM, all of one name or one of them."""
    holder, key = _some(every, rng, is_number)
    chosen = _alike(every, key) if rng.random() < 0.5 else [(holder, key)]
    for some, k in chosen:
        some[k] = some[k] + 5_336_000.0 if is_number(some[k]) else some[k]
    return f"{len(chosen)} of {key!r} in UTM"


def _turn(document: Any, every: list[Place], rng: Rng) -> str:
    """Angles have the other sign, or are degrees."""
    words = ("rotation", "yaw_deg", "yaw", "z", "rotation_y", "angle")
    turned = [(h, k) for h, k in every if k in words and is_number(h[k])]
    factor = pick(rng, (-1.0, 180 / np.pi, np.pi / 180))
    for holder, key in turned:
        holder[key] = holder[key] * factor
    return f"{len(turned)} angles times {factor:.3g}"


def json_doubled(content: bytes, rng: Rng) -> tuple[str, bytes]:
    """A key of a JSON text is there twice, with two values."""
    found = list(re.finditer(rb'"(\w+)"\s*:\s*', content))
    if not found:
        return "nothing", content
    key = pick(rng, found)
    other = pick(rng, (b"null", b"0", b"[]", b'"other"', b"1e9"))
    where = key.start() if rng.random() < 0.5 else key.end()
    return f"{key[1]!r} twice", content[: key.start()] + key[0] + other + b"," + content[
        where if where == key.start() else key.start() :
    ]


STRUCTURED_JSON: tuple[Mutation, ...] = (*[json_change] * 9, json_doubled)


# Texts of lines and columns, YAML, XML, TOML

_NUMBER = re.compile(r"-?\d+\.?\d*(?:[eE][-+]?\d+)?")


def text_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    text = content.decode(errors="replace")
    lines = text.splitlines()
    k = int(rng.integers(len(lines))) if lines else 0
    changes: dict[str, Callable[[], str | bytes]] = {
        "decimal commas": lambda: re.sub(r"(\d)\.(\d)", r"\1,\2", text),
        "a word among the numbers": lambda: _on_number(text, rng, lambda number: "hello"),
        "a number times 1000": lambda: _on_number(
            text, rng, lambda number: f"{float(number) * 1000:g}"
        ),
        "a column times 1000": lambda: "\n".join(_scaled_column(line, k % 4) for line in lines),
        "two columns exchanged": lambda: "\n".join(_swapped_columns(line) for line in lines),
        "a line of a million characters": lambda: "\n".join(
            [*lines[:k], "#" + "x" * 10**6, *lines[k:]]
        ),
        "a comment of 2,000 characters": lambda: "\n".join(
            [*lines[:1], "comment " + "x" * 2000, *lines[1:]]
        ),
        "a million empty lines": lambda: text + "\n" * 10**6,
        "in UTF-16": lambda: text.encode("utf-16"),
        "with CR alone": lambda: text.replace("\n", "\r"),
        "with a zero byte": lambda: text[: len(text) // 2] + "\0" + text[len(text) // 2 :],
        "backwards": lambda: "\n".join(lines[::-1]),
        "columns in another unit": lambda: re.sub(
            r"\b[xyz]\b", lambda axis: f"{axis[0]}_{pick(rng, UNITS)}", text
        ),
        "columns of a frame": lambda: re.sub(
            r"\b[xyz]\b", lambda axis: f"{axis[0]}_{pick(rng, FRAMES)}", text
        ),
        "an offset in a comment": lambda: f"# offset: {OFFSET}\n{text}",
        "in UTM": lambda: "\n".join(_shifted_column(line, k % 3) for line in lines),
        "twice": lambda: f"{text}\n{text}",
        "with semicolons": lambda: re.sub(r"[ ,\t]+", ";", text),
        "a row too long": lambda: "\n".join(
            [*lines[:k], f"{lines[k] if lines else ''} 7 7 7", *lines[k + 1 :]]
        ),
        "a row too short": lambda: "\n".join(
            [*lines[:k], " ".join((lines or [""])[k].split()[:-1]), *lines[k + 1 :]]
        ),
        "a terminal's escape": lambda: "\n".join(
            [*lines[:k], "\x1b[2J\x1b]0;owned\x07\u202e", *lines[k:]]
        ),
    }
    what = pick(rng, list(changes))
    made = changes[what]()
    return what, made if isinstance(made, bytes) else made.encode(errors="replace")


def _on_number(text: str, rng: Rng, change: Callable[[str], str]) -> str:
    found = list(_NUMBER.finditer(text))
    if not found:
        return text
    number = pick(rng, found)
    return text[: number.start()] + change(number[0]) + text[number.end() :]


def _scaled_column(line: str, column: int) -> str:
    words = line.split()
    if len(words) > column and _NUMBER.fullmatch(words[column]):
        words[column] = f"{float(words[column]) * 1000:g}"
    return " ".join(words)


def _shifted_column(line: str, column: int) -> str:
    words = line.split()
    if len(words) > column and _NUMBER.fullmatch(words[column]):
        words[column] = f"{float(words[column]) + 5_336_000.0:.3f}"
    return " ".join(words)


def _swapped_columns(line: str) -> str:
    words = line.split()
    return " ".join([words[1], words[0], *words[2:]]) if len(words) > 2 else line


def yaml_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    text = content.decode(errors="replace")
    bomb = "a0: &a0 [x,x,x,x,x,x,x,x,x]\n" + "".join(
        f"a{k}: &a{k} [{','.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12)
    )
    keys = re.findall(r"^\s*([\w]+):", text, re.M) or ["a"]
    key = pick(rng, keys)
    changes = {
        "aliases that unfold to gigabytes": bomb + text,
        "aliases in place of values": bomb
        + re.sub(rf"^(\s*{key}:).*", r"\1 *a11", text, flags=re.M),
        "merged with itself": f"base: &base\n  <<: *base\n{text}",
        "nested 5,000 deep": f"{text}\nmore: {'[' * 5000}{']' * 5000}\n",
        "a Python object": f"{text}\nmore: !!python/object/apply:os.system ['true']\n",
        f"{key} twice": f"{text}\n{key}: 1\n",
        f"{key} without value": re.sub(rf"^(\s*{key}:).*", r"\1", text, flags=re.M),
        f"{key} is a date": re.sub(rf"^(\s*{key}:).*", r"\1 2026-11-23", text, flags=re.M),
        f"{key} is a name of a megabyte": re.sub(
            rf"^(\s*{key}:).*", rf"\1 {'N' * 10**6}", text, flags=re.M
        ),
        "a whole number of 5,000 digits": re.sub(r"\d+", "9" * 5000, text, count=1),
        "an integer in base 60": re.sub(r"\d+\.?\d*", "1:30:00", text, count=1),
    }
    what = pick(rng, list(changes))
    return what, changes[what].encode()


STRUCTURED_TEXT: tuple[Mutation, ...] = (text_change,)
STRUCTURED_YAML: tuple[Mutation, ...] = (yaml_change, yaml_change, text_change)


def xml_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    text = content.decode(errors="replace")
    attributes = list(re.finditer(r'\b([\w:]+)="([^"]*)"', text))
    chosen = pick(rng, attributes)
    name, value = chosen[1], chosen[2]

    def put(other: str) -> str:
        return text[: chosen.start(2)] + other + text[chosen.end(2) :]

    def put_all(change: Callable[[float], float]) -> str:
        return re.sub(
            rf'\b{name}="(-?[\d.]+)"', lambda found: f'{name}="{change(_float(found[1]))!r}"', text
        )

    head, body = text.split("\n", 1) if "\n" in text else ("", text)
    entities = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 10))
    changes: dict[str, Callable[[], str]] = {
        f"every {name} times 1000": lambda: put_all(lambda value: value * 1000),
        f"every {name} times -1": lambda: put_all(lambda value: -value),
        f"{name} is -10": lambda: put("-10"),
        f"{name} is 1e308": lambda: put("1e308"),
        f"{name} is 1e-9": lambda: put("1e-9"),
        f"{name} is nan": lambda: put("nan"),
        f"{name} has 400 digits": lambda: put("9" * 400),
        f"{name} has a decimal comma": lambda: put(value.replace(".", ",")),
        f"{name} has a unit": lambda: put(f"{value} ft"),
        f"{name} escapes": lambda: put("&#x202e;../../etc"),
        f"{name} of a megabyte": lambda: put("N" * 10**6),
        f"{name} is another's": lambda: put(pick(rng, attributes)[2]),
        f"no {name}": lambda: re.sub(rf'\s\b{name}="[^"]*"', "", text),
        f"{name} twice": lambda: text[: chosen.end()] + " " + chosen[0] + text[chosen.end() :],
        "a place out of range": lambda: re.sub(
            rf'\b({pick(rng, ("lat", "lon", "x", "y", "s", "length"))})="[^"]*"',
            lambda m: f'{m[1]}="{pick(rng, ("95", "400", "-179.9", "nan", "inf", "1e308", ""))}"',
            text,
            count=int(rng.integers(1, 4)),
        ),
        "two of one id": lambda: re.sub(
            r'\bid="[^"]*"', f'id="{pick(rng, ("1", "2", "100"))}"', text, count=3
        ),
        "entities that unfold to gigabytes": lambda: (
            f'{head}<!DOCTYPE x [<!ENTITY e0 "lol">{entities}]>\n'
            + body.replace(chosen[0], f'{name}="&e9;"', 1)
        ),
        "an entity of a file": lambda: (
            f'{head}<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]>\n{body}'
        ),
        "a comment of a megabyte": lambda: f"{head}\n<!--{'- ' * 500000}-->\n{body}",
        "a comment that does not end": lambda: f"{head}\n<!--{'<' * 10**6}\n{body}",
        "nested 100,000 deep": lambda: re.sub(
            r"(</\w+>\s*)$", "<a>" * 10**5 + "</a>" * 10**5 + r"\1", text
        ),
        "its elements 300 times": lambda: re.sub(
            r"(<(?:way|object)\b.*?</(?:way|object)>)",
            lambda m: m[1] * 300,
            text,
            count=1,
            flags=re.S,
        ),
    }
    what = pick(rng, list(changes))
    return what, changes[what]().encode(errors="replace")


def _float(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0


STRUCTURED_XML: tuple[Mutation, ...] = (xml_change,)

_ROAD_TAGS = {  # units, frames and sides of the road, as mappers write them and as they should not
    "maxspeed": (
        "30 mph",
        "50 knots",
        "walk",
        "none",
        "signals",
        "DE:urban",
        "XX:rural",
        "1e9",
        "-5",
        "50;30",
        "٥٠",
    ),
    "maxspeed:backward": ("20", "GB:nsl_single", "fast"),
    "oneway": ("-1", "reversible", "alternating", "yes;no", "1.0"),
    "oneway:bicycle": ("no",),
    "access": ("no", "private", "destination;delivery", "sometimes", "no @ (22:00-06:00)"),
    "motor_vehicle": ("no", "agricultural", "yes;no"),
    "motor_vehicle:forward": ("no",),
    "motor_vehicle:conditional": ("no @ (Mo-Fr 07:00-09:00)",),
    "bus:lanes": ("yes|designated", "|||||"),
    "lanes": ("0", "2;3", "99", "1.5", "-1"),
    "turn:lanes": ("left|through", "||"),
    "driving_side": ("left", "both"),
    "junction": ("roundabout", "circular"),
    "barrier": ("bollard", "gate", "block"),
    "maxweight": ("3.5 t", "7500 kg", "5 st", "heavy"),
    "highway": ("motorway", "track", "busway", "residential;service", ""),
    "name": ("信号灯杆一", "عمود", "a;b", "&#10;"),
}


def osm_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    """A map whose places, roads or rules are in other units, of another side, of other kinds, or
    lack a partner."""
    text = content.decode(errors="replace")
    key = pick(rng, list(_ROAD_TAGS))
    value = pick(rng, _ROAD_TAGS[key])
    tag, way = f'<tag k="{key}" v="{value}"/>', pick(rng, ["100", "101"])
    via = pick(
        rng,
        [
            'type="node" ref="2"',
            'type="node" ref="9999"',
            'type="way" ref="101"',
            'type="relation" ref="1"',
        ],
    )
    kind = pick(rng, ["no_left_turn", "only_straight_on", "no_u_turn", "no", "", "no_entry"])
    turn = f'<relation id="7"><member type="way" ref="100" role="from"/><member {via} role="via"/>'
    turn += (
        f'<member type="way" ref="{way}" role="to"/><tag k="type" v="restriction"/><tag '
        f'k="restriction" v="{kind}"/>'
    )
    changes: dict[str, Callable[[], str]] = {
        f"a road with {key}={value}": lambda: text.replace(
            f'<way id="{way}">', f'<way id="{way}">{tag}'
        ),
        f"a node with {key}={value}": lambda: re.sub(
            r'(<node id="2"[^>]*)/>', rf"\1>{tag}</node>", text
        ),
        "latitude and longitude exchanged": lambda: re.sub(
            r'lat="(.*?)" lon="(.*?)"', r'lat="\2" lon="\1"', text
        ),
        "places in thousandths": lambda: re.sub(
            r'(lat|lon)="([\d.]+)"', lambda found: f'{found[1]}="{float(found[2]) * 1000}"', text
        ),
        "a node that is missing": lambda: re.sub(rf'<node id="{pick(rng, "12345")}".*\n', "", text),
        "a way that is deleted": lambda: text.replace(
            f'<way id="{way}"', f'<way action="delete" id="{way}"'
        ),
        "a rule of turning": lambda: text.replace("</osm>", f"{turn}</relation></osm>"),
        "numbers of a draft": lambda: re.sub(r'(id|ref)="(\d+)"', r'\1="-\2"', text),
        "Overpass ran out of time": lambda: text.replace(
            "</osm>", "<remark>runtime error: timed out</remark></osm>"
        ),
    }
    what = pick(rng, list(changes))
    return what, changes[what]().encode()


_POLE_SYSTEMS = (
    "EPSG:25833",
    "urn:ogc:def:crs:EPSG::4326",
    "urn:ogc:def:crs:OGC:1.3:CRS84",
    "EPSG:2227",
    "",
    "31468",
)


def geojson_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    """Poles in another system, order or unit, or without a place."""
    document = json.loads(content)
    feature = pick(rng, document["features"])
    crs = {"type": "name", "properties": {"name": pick(rng, _POLE_SYSTEMS)}}

    def swap() -> None:
        feature["geometry"]["coordinates"] = list(reversed(feature["geometry"]["coordinates"]))

    def scale() -> None:
        def scaled(value: Any) -> Any:
            return [scaled(part) for part in value] if isinstance(value, list) else value * 1000.0

        feature["geometry"]["coordinates"] = scaled(feature["geometry"]["coordinates"])

    changes: dict[str, Callable[[], object]] = {
        "a system": lambda: document.update(crs=crs),
        "a system of a feature": lambda: feature.update(crs=crs),
        "a system of a geometry": lambda: feature["geometry"].update(crs=crs),
        "no site's metres": lambda: document.pop("coview_site", None),
        "coordinates turned round": swap,
        "coordinates in millimetres": scale,
        "a feature without a place": lambda: feature.update(geometry=None),
        "a name beyond Latin": lambda: feature["properties"].update(
            name=pick(rng, ["信号灯杆一", "עמוד", "\ue000", "a\n;b"])
        ),
    }
    what = pick(rng, list(changes))
    changes[what]()
    return what, json.dumps(document).encode()


STRUCTURED_OSM: tuple[Mutation, ...] = (xml_change, osm_change, osm_change)
STRUCTURED_GEOJSON: tuple[Mutation, ...] = (*STRUCTURED_JSON, *[geojson_change] * 5)


def toml_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    text = content.decode()
    pairs = list(re.finditer(r"^(\w+) = (.*)$", text, re.M))
    pair = pick(rng, pairs)
    values = (
        "1000000",
        "1e9",
        "-1",
        "0",
        "nan",
        "inf",
        '""',
        '"\\u202e"',
        "[]",
        "true",
        "2026-11-23",
        "0x7fffffffffffffff",
        "9" * 400,
    )
    value = pick(rng, (*values, '"' + "N" * 10**6 + '"', "[" * 3000 + "]" * 3000))
    changes = {
        f"{pair[1]} is {value[:20]}": text[: pair.start(2)] + value + text[pair.end(2) :],
        f"no {pair[1]}": text[: pair.start()] + text[pair.end() :],
        f"{pair[1]} twice": text[: pair.end()] + "\n" + pair[0] + text[pair.end() :],
        f"{pair[1]} is misspelt": text[: pair.end(1)] + "s" + text[pair.end(1) :],
        "a key of 30,000 dots": f"{'.'.join('a' * 30000)} = 1\n{text}",
        "a table 30,000 deep": f"{text}\n[{'.'.join('a' * 30000)}]\n",
        "itself again 300 times": text
        + "\n".join(
            text.replace('name = "', f'name = "{k}').split("\n\n", 1)[-1] for k in range(300)
        ),
        "values of every number times 1000": re.sub(
            r"= (\d+\.?\d*)$", lambda found: f"= {float(found[1]) * 1000:g}", text, flags=re.M
        ),
    }
    what = pick(rng, list(changes))
    return what, changes[what].encode()


STRUCTURED_TOML: tuple[Mutation, ...] = (toml_change, toml_change, text_change)


# Clouds and meshes


def ply_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    end = content.index(b"end_header")
    lines, body = content[:end].decode().splitlines(), content[end:]
    vertex = next(i for i, line in enumerate(lines) if line.startswith("element vertex"))
    properties = [i for i, line in enumerate(lines) if line.startswith("property")]
    k = pick(rng, properties)
    kinds = (
        "char",
        "uchar",
        "short",
        "ushort",
        "int",
        "uint",
        "float",
        "double",
        "list uchar int",
        "half",
        "float128",
    )
    changes: dict[str, list[str]] = {
        "a comment of 2,000 characters": [*lines[:2], "comment " + "x" * 2000, *lines[2:]],
        "a name of 2,000 characters": [*lines[:k], f"{lines[k]}{'x' * 2000}", *lines[k + 1 :]],
        "an element before the points": [
            *lines[:vertex],
            "element camera 1",
            "property float fx",
            *lines[vertex:],
        ],
        "an empty element before": [
            *lines[:vertex],
            "element camera 0",
            "property float fx",
            *lines[vertex:],
        ],
        "an element of lists before": [
            *lines[:vertex],
            "element face 1",
            "property list uchar int vertex_indices",
            *lines[vertex:],
        ],
        "an element after": [*lines, "element face 3", "property list uchar int vertex_indices"],
        "a type changed": [
            *lines[:k],
            f"property {pick(rng, kinds)} {lines[k].split()[-1]}",
            *lines[k + 1 :],
        ],
        "a property twice": [*lines[: k + 1], lines[k], *lines[k + 1 :]],
        "a property gone": [*lines[:k], *lines[k + 1 :]],
        "the other order of bytes": [line.replace("little", "big") for line in lines],
        "the other format": [
            re.sub(
                r"^format \w+",
                "format ascii" if "binary" in line else "format binary_little_endian",
                line,
            )
            for line in lines
        ],
        **{
            f"{n} points": [*lines[:vertex], f"element vertex {n}", *lines[vertex + 1 :]]
            for n in (*COUNTS, 0, 3, "many")
        },
        "points twice": [*lines, *lines[vertex : properties[-1] + 1]],
        "an offset in a comment": [*lines[:2], f"comment offset {OFFSET}", *lines[2:]],
        "in another unit": [
            re.sub(r" ([xyz])$", rf" \1_{pick(rng, UNITS)}", line) for line in lines
        ],
    }
    what = pick(rng, list(changes))
    return what, "\n".join(changes[what]).encode() + b"\n" + body


def pcd_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    end = content.index(b"DATA")
    lines, body = content[:end].decode().splitlines(), content[end:]
    k = pick(
        rng,
        [
            i
            for i, line in enumerate(lines)
            if line.split()[0]
            in ("FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "FIRST_HEIGHT_M", "POINTS", "VIEWPOINT")
        ],
    )
    words = lines[k].split()
    j = int(rng.integers(1, len(words)))
    others = (
        "0",
        "-1",
        "3",
        "8",
        "3000000",
        "4294967295",
        str(2**62),
        "x",
        "F",
        "U",
        "I",
        "nan",
        "1e9",
        "N" * 100000,
    )
    if rng.random() < 0.2 and b"binary_compressed" in body[:30]:
        at = body.index(b"\n") + 1
        sizes = struct.pack(
            "<II",
            int(pick(rng, (0, 10, 2**31, 2**32 - 1))),
            int(pick(rng, (0, 10, 2**31, 2**32 - 1))),
        )
        return "sizes of the packed points changed", content[:end] + body[:at] + sizes + body[
            at + 8 :
        ]
    if rng.random() < 0.3 and not body.startswith(b"DATA ascii"):
        at, size = body.index(b"\n") + 1, int(pick(rng, (1, 3, 16, 32, 33)))
        bodies = {
            "missing": body[:-size],
            "more": body + bytes(size),
            "zero": body[:at] + bytes(len(body) - at),
        }
        what = pick(rng, list(bodies))
        return f"{size} bytes {what}", content[:end] + bodies[what]
    what = pick(rng, ("other", "gone", "doubled", "swapped", "row", "origin", "unit"))
    if what == "origin":
        words = [
            f"# coview origin: {pick(rng, (OFFSET, '692000 5336000', '1e12 0 0', 'north 0 0'))}"
        ]
    elif what == "unit":
        words[j] += f"_{pick(rng, UNITS)}"
    elif what == "other":
        words[j] = pick(rng, others)
    elif what == "gone":
        del words[j]
    elif what == "doubled":
        words.insert(j, words[j])
    elif what == "swapped":
        words[j], words[1] = words[1], words[j]
    lines[k : k + 1] = [] if what == "row" else [" ".join(words)]
    return f"{words[0]} {j} {what} {words[min(j, len(words) - 1)][:20]}", "\n".join(
        lines
    ).encode() + b"\n" + body


def npy_bytes(array: np.ndarray, **header: Any) -> bytes:
    """As NumPy writes it, with another header where given."""
    stream = io.BytesIO()
    usual = {"descr": array.dtype.str, "fortran_order": False, "shape": array.shape}
    np.lib.format.write_array_header_1_0(stream, {**usual, **header})
    return stream.getvalue() + array.tobytes()


def _headers(rng: Rng) -> dict[str, Any]:
    return pick(
        rng,
        (
            *({"shape": (n, 3)} for n in (10**6, 10**9, 10**12, 2**62)),
            *(
                {"shape": (0, 3)},
                {"shape": (3, 200)},
                {"shape": (600,)},
                {"shape": ()},
                {"shape": (1, 200, 3)},
            ),
            *(
                {"fortran_order": True},
                {"descr": ">f4"},
                {"descr": "<f2"},
                {"descr": "<f8"},
                {"descr": "<c8"},
                {"descr": "|O"},
            ),
            *(
                {"descr": "|V4"},
                {"descr": "<U1"},
                {"descr": "|b1"},
                {"descr": "<M8[s]"},
                {"descr": [("x", "<f4")]},
            ),
        ),
    )


def npy_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    array, header = np.load(io.BytesIO(content)), _headers(rng)
    if rng.random() < 0.3:
        factor = pick(rng, (1e3, 1e6, 1e30, np.nan))
        return f"times {factor:g}", npy_bytes((array * factor).astype(array.dtype))
    return f"header {header}", npy_bytes(array, **header)


def npz_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    """One entry of an archive is something else, unfolds to gigabytes, or is there twice."""
    with np.load(io.BytesIO(content)) as file:
        arrays = {name: npy_bytes(file[name]) for name in file.files}
        name = pick(rng, list(arrays))
        array = file[name]
    header, stream, extra = _headers(rng), io.BytesIO(), {}
    changes: dict[str, Callable[[], bytes]] = {
        "no array": lambda: b"a text",
        "a pickle": lambda: b"\x80\x04N.",
        "nothing": lambda: b"",
        f"of header {header}": lambda: npy_bytes(array, **header),
        "six gigabytes of zeros": lambda: b"",
        "times 1000": lambda: npy_bytes(np.asarray(array * 1000.0)),
        "one row less": lambda: npy_bytes(array[:-1] if array.ndim else array),
        "of texts": lambda: npy_bytes(np.full(array.shape, "x")),
    }
    what = pick(rng, list(changes))
    arrays[name] = changes[what]()
    if rng.random() < 0.2:
        extra[pick(rng, ("../up", "/up/x", "N" * 60000, "positions.npy", "\u202e"))] = npy_bytes(
            np.zeros(3)
        )
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as made:
        for each, body in {**arrays, **extra}.items():
            if what.startswith("six") and each == name:
                _write_zeros(made, f"{each}.npy", array)
            else:
                made.writestr(f"{each}.npy", body)
    return (
        f"{name} is {what}{' beside ' + next(iter(extra))[:10] if extra else ''}",
        stream.getvalue(),
    )


def _write_zeros(
    archive: zipfile.ZipFile, name: str, array: np.ndarray, size: int = 3 << 30
) -> None:
    width = max(1, int(np.prod(array.shape[1:], dtype=int))) * array.dtype.itemsize
    header = npy_bytes(
        array[:0] if array.ndim else np.zeros(0), shape=(size // width, *array.shape[1:])
    )
    with archive.open(name, "w", force_zip64=True) as file:
        file.write(header)
        for _ in range(size // (1 << 24)):
            file.write(bytes(1 << 24))


def feather_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    import pyarrow
    from pyarrow import feather

    table = feather.read_table(io.BytesIO(content))
    name = pick(rng, table.column_names)
    index, column = table.column_names.index(name), table[name].combine_chunks()
    numeric = pyarrow.types.is_floating(column.type) or pyarrow.types.is_integer(column.type)
    values = column.to_numpy(zero_copy_only=False)
    others: dict[str, Callable[[], Any]] = {
        "texts": lambda: pyarrow.array([str(value) for value in values]),
        "nulls": lambda: pyarrow.nulls(len(values), column.type),
        "lists": lambda: pyarrow.array([[1.0]] * len(values)),
        "backwards": lambda: column[::-1] if hasattr(column, "__getitem__") else column,
        "times 1000": lambda: pyarrow.array(values * 1000.0 if numeric else values),
        "nan": lambda: pyarrow.array(np.full(len(values), np.nan)),
        "huge": lambda: pyarrow.array(np.full(len(values), 2**62)),
        "a dictionary": lambda: pyarrow.array(["a"] * len(values)).dictionary_encode(),
        "moments": lambda: pyarrow.array(np.arange(len(values)), pyarrow.timestamp("us")),
    }
    what, stream = pick(rng, (*others, "gone", "doubled", "four gigabytes", "empty")), io.BytesIO()
    if what in others:
        table = table.set_column(index, name, others[what]())
    elif what == "gone":
        table = table.drop_columns([name])
    elif what == "doubled":
        table = table.append_column(name, column)
    elif what == "empty":
        table = table.slice(0, 0)
    else:
        zeros = pyarrow.RecordBatch.from_arrays(
            [pyarrow.array(np.zeros(1 << 22, np.float32)).cast(pyarrow.float32())]
            * len(table.column_names),
            names=table.column_names,
        )
        options = pyarrow.ipc.IpcWriteOptions(compression="zstd")
        with pyarrow.ipc.new_file(stream, zeros.schema, options=options) as writer:
            for _ in range(max(1, 256 // len(table.column_names))):
                writer.write_batch(zeros)
        return f"{what} of {name}", stream.getvalue()
    feather.write_feather(table, stream, compression="uncompressed")
    return f"{name}: {what}", stream.getvalue()


def bin_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    rows = np.frombuffer(content[: len(content) // 16 * 16], "<f4").reshape(-1, 4)
    changes = {
        "of doubles": rows.astype("<f8"),
        "of the other order of bytes": rows.astype(">f4"),
        "of three columns": rows[:, :3],
        "of five columns": np.column_stack([rows, rows[:, 0]]),
        "in millimetres": rows * np.float32(1000),
        "of whole numbers": rows.astype("<i4"),
        "of zeros": rows * 0,
        "with a run of zeros": rows
        * (np.abs(np.arange(len(rows)) - rng.integers(len(rows))) > len(rows) / 5)[:, None],
        "one column in millimetres": rows * np.where(np.arange(4) == rng.integers(3), 1000, 1),
    }
    what = pick(rng, list(changes))
    made = changes[what] if "of " in what else changes[what].astype("<f4")
    return what, np.ascontiguousarray(made).tobytes()


def glb_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    """A binary glTF whose JSON says something else."""
    (length,) = struct.unpack("<I", content[12:16])
    what, text = json_change(content[20 : 20 + length], rng)
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    head = b"glTF" + struct.pack("<II", 2, 20 + len(text) + len(rest))
    return what, head + struct.pack("<I", len(text)) + b"JSON" + text + rest


def stl_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    count = pick(rng, (0, 1, 10**6, 2**32 - 1))
    return f"{count} faces", content[:80] + struct.pack("<I", count) + content[84:]


# HDF5


def hdf5_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    """An HDF5 file of other units, axes, times or names, with links out of it or declared far
    larger than it is."""
    stream = io.BytesIO(content)
    with h5py.File(stream, "r+") as file:
        datasets: list[str] = []
        file.visititems(
            lambda name, node: datasets.append(name) if isinstance(node, h5py.Dataset) else None
        )
        name = pick(rng, datasets)
        was, attributes = file[name], dict(file[name].attrs)
        values, what = was[()], ""
        if isinstance(values, bytes):
            what, text = _changed_text(values, rng)
            del file[name]
            file[name] = text
            return f"{name}: {what}", _closed(file, stream)
        what = pick(
            rng,
            (
                "units",
                "axes",
                "back",
                "doubled",
                "external",
                "storage",
                "virtual",
                "bomb",
                "names",
                "same",
            ),
        )
        numeric = np.issubdtype(values.dtype, np.number)
        del file[name]
        if what == "units" and numeric:
            factor = pick(rng, FACTORS)
            with np.errstate(all="ignore"):
                file[name] = (values * factor).astype(values.dtype)
            what = f"times {factor:g}"
        elif what == "axes" and values.ndim and values.shape[-1] > 1:
            file[name] = values[..., [1, 0, *range(2, values.shape[-1])]]
        elif what == "back" and values.ndim:
            file[name] = values[::-1]
        elif what == "doubled" and values.ndim:
            file[name] = np.repeat(values, 2, axis=0)
        elif what == "same" and values.ndim and len(values):
            file[name] = np.repeat(values[:1], len(values), axis=0)
        elif what == "external":
            file[name] = h5py.ExternalLink("/etc/hostname", "/there")
        elif what == "storage" and numeric:
            file.create_dataset(
                name, was.shape, was.dtype, external=[("/etc/passwd", 0, h5py.h5f.UNLIMITED)]
            )
        elif what == "virtual" and numeric and values.ndim:
            layout = h5py.VirtualLayout(was.shape, was.dtype)
            layout[...] = h5py.VirtualSource("/etc/passwd", "x", was.shape)
            file.create_virtual_dataset(name, layout)
        elif what == "bomb" and numeric:
            shape = (
                (10**8 // max(1, int(np.prod(was.shape[1:]))) * 8, *was.shape[1:])
                if was.ndim
                else (10**9,)
            )
            file.create_dataset(name, shape, was.dtype, chunks=True, compression="gzip")
        else:
            file[name] = (
                np.full(values.shape, pick(rng, NAMES)[:2000].encode(), "S2000")
                if values.size < 2000
                else values[:0]
            )
            what = "names"
        if isinstance(file.get(name, getlink=True), h5py.HardLink):
            file[name].attrs.update(attributes)
        return f"{name}: {what}", _closed(file, stream)


def _closed(file: h5py.File, stream: io.BytesIO) -> bytes:
    file.close()
    return stream.getvalue()


def _changed_text(values: bytes, rng: Rng) -> tuple[str, bytes]:
    try:
        document = json.loads(values)
    except ValueError:
        return "another name", pick(rng, NAMES)[:5000].encode()
    return json_change(values, rng) if isinstance(document, dict | list) else ("number", b"9" * 400)


STRUCTURED_HDF5: tuple[Mutation, ...] = (hdf5_change,)


def osm_gz_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    """A packed map that unfolds to a comment or a map of gigabytes, or one whose text is
    changed."""
    import gzip

    text = gzip.decompress(content)
    if rng.random() < 0.6:
        what, changed = xml_change(text, rng)
        return what, gzip.compress(changed, mtime=0)
    head, body = text.split(b"\n", 1)
    stream, filling = io.BytesIO(), pick(rng, (b"-", b"<", b" ", b"\n"))
    with gzip.GzipFile(fileobj=stream, mode="w") as file:
        file.write(head + b"\n<!--")
        for _ in range(pick(rng, (1, 15, 3000))):
            file.write(filling * (1 << 20))
        file.write(b"-->\n" + body)
    return f"a comment of {filling!r}", stream.getvalue()


# Networks: what a header or a card declares

_SIZES: dict[str, tuple[object, ...]] = {
    "area": (
        [-2000, -2000, 2000, 2000],
        [-1e6, -1e6, 1e6, 1e6],
        [0, 0, 1e-9, 1e-9],
        [0, 0, 0, 0],
        [6.4, 6.4, 0, 0],
    ),
    "voxel_size": (
        [1e-6, 1e-6, 1e-6],
        [1e-3, 1e-3, 0.4],
        [0.2, 0.2, 1e-5],
        [1e6, 1e6, 1e6],
        [-1, 0.2, 0.4],
    ),
    "height": ([0, 1e6], [-1e6, 1e6], [4, 0]),
    "max_points": (0, 10**9, 999_999, -1),
    "vfe_widths": ([10**5, 10**5], [999_999], [0], [8] * 5000),
    "voxel_width": (10**5, 0, -3, 999_999),
    "middle_widths": ([999_999] * 3, [0, 0, 0], []),
    "column_width": (999_999, -1),
    "rpn_widths": ([999_999] * 3, [0, 0, 0], [-1, 8, 8]),
    "rpn_layers": ([[999_999], [0], [0]], [[0] * 100_000] * 3, [[], [], []], [[-1], [0], [0]]),
    "upsample_width": (999_999, 0, -1),
    "head3x3": (999_999, -1),
    "anchor_yaws": ([0.1] * 100_000, []),
    "anchor_size": ([1e6, 1e6, 1e6], [0, 0, 0], [1e-9, 1e-9, 1e-9]),
    "quality_power": (1e6, -1e6),
    "averaging": (1e6, -5),
    "score_threshold": (-1, 1, 0.999999),
    "labels": ([], ["vehicle"] * 2000, ["heavy"]),
    "nms_threshold": (-1, 1e6, 0),
}


def size_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    """One or two entries of a card are of another size."""
    card = json.loads(content)
    names = [pick(rng, list(_SIZES)) for _ in range(int(rng.integers(1, 3)))]
    card.update({name: pick(rng, _SIZES[name]) for name in names})
    return f"{' and '.join(names)} of another size", json.dumps(card).encode()


def header_change(content: bytes, rng: Rng) -> tuple[str, bytes]:
    """The configuration in the header of weights is damaged as a card."""
    size = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + size])
    config = header["__metadata__"]["config"].encode()
    what, changed = pick(rng, (size_change, size_change, json_change))(config, rng)
    header["__metadata__"]["config"] = changed.decode()
    packed = json.dumps(header).encode()
    packed += b" " * (-len(packed) % 8)
    return what, len(packed).to_bytes(8, "little") + packed + content[8 + size :]


STRUCTURED_CARD: tuple[Mutation, ...] = (size_change, size_change, json_change)
