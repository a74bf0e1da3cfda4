"""Options for writing what was found in the formats of other programs."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from coview.arguments import check_each_once, check_ending
from coview.outputs import Writing, check_empty_folder, check_file

if TYPE_CHECKING:
    from toolkit.exchange.geo_origin import GeoOrigin
    from toolkit.sites.site import Site

StandardName = Literal[
    "kitti-tracking", "openlabel", "mf-json", "mcap", "detection3d", "osi", "cpm"
]


@dataclass(frozen=True, kw_only=True)
class Exchange(Writing):
    """Handling of results, and formats of other programs."""

    to: tuple[StandardName, ...] = ()
    """Formats in place of --format: kitti-tracking (text), openlabel and mf-json (OGC moving
    features) of the whole recording, mcap (Foxglove: boxes and clouds), detection3d (a ROS 2
    bag), osi (ASAM GroundTruth) and cpm (messages of ETSI TS 103 324 as a capture, .pcap). --out is
    the file, or a folder for several."""
    origin: tuple[float, float] | None = None
    """Latitude and longitude of the recording's 0 0 0, x east, for mf-json and cpm; known for sites
    with a place on earth."""
    asn1: Path | None = None
    """Folder of ETSI's ASN.1 modules for cpm: CPM-PDU-Descriptions and what it imports."""

    def check(self, out: Path, inputs: Iterable[Path]) -> dict[str, Path]:
        """Check options and files before long work; return the file of each format by its name.

        out: the file for one format, their folder for several; inputs: files that are read. Raises
        ValueError and OSError for files that cannot be written and for ASN.1 modules that are
        missing or wrong, ImportError for a missing package."""
        from toolkit.exchange.standards import find_standard

        check_each_once("--to", self.to)
        inputs = list(inputs)
        files: dict[str, Path] = {}
        for name in self.to:
            standard = find_standard(name)
            standard.check_packages()
            path = out if len(self.to) == 1 else out / f"{name}{standard.ending}"
            if standard.ending:
                check_ending(path, (standard.ending,), f"a file of {name}")
            # a format without an ending writes a folder
            check_out = check_file if standard.ending else check_empty_folder
            check_out(path, inputs=inputs, overwrite=self.overwrite)
            files[name] = path
        self._check_asn1()
        return files

    def place(self, site: "Site | None") -> "GeoOrigin | None":
        """Return the place on earth of a recording, None if no format needs it.

        site: the recording's, None if unknown. Raises ValueError if the place is needed and
        unknown, and for --origin if it is not needed."""
        from toolkit.exchange.geo_origin import GeoOrigin
        from toolkit.exchange.standards import find_standard

        placed_formats = [name for name in self.to if find_standard(name).needs_place]
        if self.origin is not None and not placed_formats:
            raise ValueError("--origin is for --to mf-json and cpm: leave it out")
        if not placed_formats:
            return None
        if self.origin is not None:
            return GeoOrigin(*self.origin)
        place = GeoOrigin.from_site(site)
        if place is None:
            raise ValueError(
                f"--to {placed_formats[0]} needs the place on earth of the recording, which "
                "does not state it: pass --origin LATITUDE LONGITUDE"
            )
        return place

    def _check_asn1(self) -> None:
        """Raise ValueError and OSError for ASN.1 modules that are missing, wrong or not needed."""
        from toolkit.exchange.standards import find_standard

        standards = [find_standard(name) for name in self.to]
        message_standards = [standard for standard in standards if standard.needs_asn1]
        if self.asn1 is not None and not message_standards:
            raise ValueError("--asn1 is for --to cpm: leave it out")
        for standard in message_standards:
            if self.asn1 is None:
                raise ValueError(
                    f"--to {standard.name} needs ETSI's ASN.1 modules, which coview does not have: "
                    "pass --asn1 FOLDER"
                )
            standard.check_asn1(self.asn1)
