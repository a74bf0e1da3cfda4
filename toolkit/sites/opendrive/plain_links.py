"""Links of a carriageway to other roads and junctions."""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal
from xml.etree import ElementTree

from toolkit.sites.network import format_element
from toolkit.sites.opendrive.carriageways import Carriageway, PlainWriter
from toolkit.sites.opendrive.plain_names import name_junction

Direction = Literal["predecessor", "successor"]  # at the start or end of a road


@dataclass(frozen=True)
class PlainLink:
    """Road or junction that a road leads to.

    Attributes:
        kind: "road" or "junction".
        name: its name for netconvert.
        contact: end of the other road at which the two meet, "start" or "end"; "" for a junction.
        lane_ids: ids of the lanes at this end in the file, and those that netconvert gets."""

    kind: str
    name: str
    contact: str = ""
    lane_ids: Mapping[int, int] = field(default_factory=dict)

    def write(self, direction: Direction) -> str:
        """Text of the <predecessor> or <successor> of OpenDRIVE 1.4."""
        row = {"elementType": self.kind, "elementId": self.name}
        if self.contact:
            row["contactPoint"] = self.contact
        return format_element(direction, row)


def find_links(
    writer: PlainWriter, road: Carriageway, left_out: Collection[str], problems: Counter[str]
) -> Iterator[tuple[Direction, PlainLink]]:
    """Yield the links of a carriageway that lead to roads and junctions in the file.

    writer: has the carriageways of all roads; left_out: ids of junctions that netconvert does not
    get; problems: links that are not used are counted there."""
    # end of the linked road, if the link does not name it
    contacts: tuple[tuple[Direction, str], ...] = (("predecessor", "end"), ("successor", "start"))
    for direction, default_contact in contacts:
        for link in road.element.findall(f"link/{direction}"):
            name = link.get("elementId", "")
            kind = link.get("elementType", "")
            is_branch = link.get("elementS") is not None
            if is_branch or (kind == "junction" and name in left_out):
                problems["roads that branch off within another road are not joined to it"] += 1
            elif kind == "junction":
                yield direction, PlainLink(kind, name_junction(name))
            elif kind == "road" and name in writer.roads:
                contact = _read_contact(link, default_contact)
                partner = _find_partner(writer, road, direction, name, contact)
                if partner.junction not in left_out:
                    lane_ids = partner.ends[contact]
                    yield direction, PlainLink(kind, partner.name, contact, lane_ids)
            else:
                problems["roads are linked to what is not in the file"] += 1


def _read_contact(link: ElementTree.Element, default_contact: str) -> str:
    """End of the road that a link leads to, "start" or "end".

    default_contact: end without a valid contactPoint."""
    contact = link.get("contactPoint", default_contact)
    return contact if contact in ("start", "end") else default_contact


def _find_partner(
    writer: PlainWriter, road: Carriageway, direction: Direction, name: str, contact: str
) -> Carriageway:
    """Carriageway of another road to which most lanes at an end of `road` are linked.

    If no lane is linked, the other road's last carriageway comes back. Its lanes are driven in the
    usual direction of their side, unless the road has contraflow lanes only.

    writer: has the carriageways of all roads. direction: the end of `road`; name: id of the other
    road; contact: end of the other road ("start" or "end")."""
    is_before = direction == "predecessor"
    section = road.sections[0 if is_before else -1]
    partners: Counter[Carriageway] = Counter()  # number of lanes linked to each
    for lane in section.lanes:
        for lane_id in lane.before if is_before else lane.after:
            partner = writer.find_lane(name, contact, lane_id)
            if partner is not None and lane not in road.closed:
                carriageway, _ = partner
                partners[carriageway] += 1
    if not partners:
        return writer.roads[name][-1]  # contraflow lanes are in those before it
    ((partner_with_most, _),) = partners.most_common(1)
    return partner_with_most
