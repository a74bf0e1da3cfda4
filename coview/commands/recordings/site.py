"""`coview site`: make, draw and check sites."""

from dataclasses import dataclass
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, subcommand

from coview.arguments import check_bearing, check_ending, check_least, check_turn, site_file
from coview.outputs import OK, SITE_KIND, check_file, say
from coview.progress_bar import progress_bar
from toolkit.plots.canvas import check_picture
from toolkit.runtime.writing import write_text

if TYPE_CHECKING:
    from toolkit.sites.site import Site

SITE_ENDINGS = (".json", ".geojson")


@dataclass(frozen=True)
class ImportMap:
    """Make a site from a real map: roads and footways, buildings, trees, furniture, signals and
    parking that it holds.

    What is along the road and in no map is drawn at random, marked as drawn in the site file, and
    listed, unless --furnish none. The site has no sensors, unless --sensors gives their number:
    coview plan and coview search find which to build.

    Example: coview site import --opendrive Town01.xodr --centre 104 -196 --size 80 40
        --out my-junction.json

    Attributes:
        centre: Centre of the detection area: metres of an OpenDRIVE map, or longitude and latitude
            of OpenStreetMap.
        size: Size of the detection area along x and y (m).
        out: Site file to write.
        opendrive: OpenDRIVE file (.xodr).
        osm: OpenStreetMap file (.osm, also .gz or .bz2, or JSON of Overpass).
        bearing: Compass bearing of the area's x axis (degrees clockwise from the map's north); 90,
            east, when left out.
        heading_deg: The same direction as a heading: degrees counter-clockwise from the map's east.
        lefthand: Let traffic keep left; without it and --righthand, traffic keeps the side that the
            map's roads (driving_side) or their country keep to (OpenStreetMap only).
        righthand: Let traffic keep right (OpenStreetMap only).
        furnish: Draw nothing, or if the map is silent uneven ground, trees along kerbs and
            street furniture (light), also houses, gardens, works and parked cars (dense).
        seed: Seed of the surroundings.
        sensors: Number of cameras to place by greedy coverage, to try the site with.
        overwrite: Replace existing files."""

    centre: tuple[float, float]
    size: tuple[float, float]
    out: Path
    opendrive: Path | None = None
    osm: Path | None = None
    bearing: float | None = None
    heading_deg: float | None = None
    lefthand: bool = False
    righthand: bool = False
    furnish: Literal["none", "light", "dense"] = "dense"
    seed: int = 0
    sensors: int | None = None
    overwrite: bool = False

    def __call__(self) -> int:
        """Import and save the site, and print a summary."""
        from toolkit.sites.maps.opendrive_site import import_opendrive
        from toolkit.sites.maps.osm_site import import_osm
        from toolkit.sites.maps.piece import MapPiece

        check_least("--seed", self.seed, 0)
        if (self.opendrive is None) == (self.osm is None):
            raise ValueError("give one map: --opendrive FILE or --osm FILE")
        if self.opendrive is not None and (self.lefthand or self.righthand):
            option = "--lefthand" if self.lefthand else "--righthand"
            raise ValueError(
                f"{option} is for --osm: an OpenDRIVE map gives the side that traffic keeps to"
            )
        if self.lefthand and self.righthand:
            raise ValueError("traffic keeps one side: give --lefthand or --righthand")
        # None for the side of the map or its country
        lefthand = self.lefthand if self.lefthand or self.righthand else None
        (map_file,) = [path for path in (self.opendrive, self.osm) if path is not None]
        check_least(
            "--sensors",
            value=self.sensors,
            minimum=1,
            remedy="leave it out for a site without sensors",
        )
        piece = MapPiece(
            map_file,
            centre=self.centre,
            size=self.size,
            heading=radians(self.find_heading()),
            seed=None if self.furnish == "none" else self.seed,
            density=self.furnish,
        )
        check_file(self.out, inputs=[map_file], overwrite=self.overwrite, kind=SITE_KIND)
        check_ending(self.out, SITE_ENDINGS, "a site's file")
        with progress_bar("import of the map"):
            site = import_osm(piece, lefthand=lefthand) if self.osm else import_opendrive(piece)
        if self.sensors is None:
            code = _save(site, self.out)
            say(
                f"it has no sensors yet: coview plan {self.out} says which to build, --sensors N "
                "places some to try"
            )
            say(
                "mounts along the kerbs are suggestions: give your own poles as --candidates "
                "FILE.geojson"
            )
            return code
        from placement_env.search.first_sensors import with_first_sensors

        with progress_bar("first sensors"):
            equipped = with_first_sensors(site, self.sensors)
        code = _save(equipped.site, self.out)
        say(equipped)
        return code

    def find_heading(self) -> float:
        """Return the heading of the area's x axis (degrees counter-clockwise from east).

        It is 0 without --bearing and --heading-deg. Raises ValueError for both."""
        if self.bearing is not None and self.heading_deg is not None:
            raise ValueError(
                "--bearing and --heading-deg are two directions of one axis: give only one"
            )
        if self.bearing is not None:  # clockwise from north
            return 90.0 - check_bearing(self.bearing, "--bearing")
        return 0.0 if self.heading_deg is None else check_turn(self.heading_deg, "--heading-deg")


@dataclass(frozen=True)
class ExportSite:
    """Write a site as GeoJSON in longitude and latitude, for QGIS and other GIS tools.

    The site file itself is GeoJSON in metres, for coview.

    Example: coview site export my-junction.json --out my-junction.geojson

    Attributes:
        site: tjunction, roundabout, or a site file.
        out: GeoJSON file to write.
        overwrite: Replace existing files."""

    site: Positional[str]
    out: Path
    overwrite: bool = False

    def __call__(self) -> int:
        """Load the site, write it, and print the path."""
        from toolkit.sites.files import load_site
        from toolkit.sites.georeference import site_geojson

        check_ending(self.out, SITE_ENDINGS, "the export")
        text = site_geojson(load_site(self.site))
        check_file(self.out, inputs=site_file(self.site), overwrite=self.overwrite)
        write_text(self.out, text)
        say(f"written to {self.out}, in longitude and latitude (WGS84)")
        return OK


@dataclass(frozen=True)
class RandomSite:
    """Draw a junction that nobody made by hand.

    Example: coview site random --seed 3 --out random-3.json

    Attributes:
        out: Site file to write.
        seed: Seed of the junction.
        overwrite: Replace existing files."""

    out: Path
    seed: int = 0
    overwrite: bool = False

    def __call__(self) -> int:
        """Draw and save a site, and print a summary."""
        from toolkit.sites.random import random_site

        check_least("--seed", self.seed, 0)
        check_ending(self.out, SITE_ENDINGS, "a site's file")
        check_file(self.out, overwrite=self.overwrite, kind=SITE_KIND)
        return _save(random_site(self.seed), self.out)


@dataclass(frozen=True)
class ShowSite:
    """Describe what a site holds, and draw it from above with --out FILE.png.

    Example: coview site show roundabout --out roundabout.png

    Attributes:
        site: tjunction, roundabout, or a site file.
        out: Picture to write.
        overwrite: Replace existing files."""

    site: Positional[str]
    out: Path | None = None
    overwrite: bool = False

    def __call__(self) -> int:
        """Load and so validate the site, describe its contents, and draw it."""
        from toolkit.plots.plan_view import draw_site
        from toolkit.sites.files import load_site
        from toolkit.sites.surroundings.things import count_things, describe_things

        site = load_site(self.site)
        check_file(self.out, inputs=site_file(self.site), overwrite=self.overwrite)
        if self.out is not None:
            check_picture(self.out)
        say(site)
        for origin, counts in count_things(site).items():
            if counts:
                say(f"{origin}: {describe_things(counts)}")
        if self.out is not None:
            draw_site(site, self.out)
        return OK


def site_command(
    command: Annotated[ImportMap, subcommand("import")]
    | Annotated[RandomSite, subcommand("random")]
    | Annotated[ShowSite, subcommand("show")]
    | Annotated[ExportSite, subcommand("export")],
) -> int:
    """Make, draw and check sites."""
    return command()


def _save(site: "Site", out: Path) -> int:
    """Save a site, print its summary and the path, and return the exit code."""
    from toolkit.sites.files import save_site

    save_site(site, out)
    say(f"{site}\nwritten to {out}")
    return OK
