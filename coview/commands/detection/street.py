"""Streets that are counted: road users of a recording or of simulated traffic, over time."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from coview.arguments import check_least, check_positive, site_file
from coview.commands.detection.detections_in_order import check_times, detect_in_order
from coview.commands.detection.placed_detectors import Detectors
from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector
from coview.progress_bar import progress_bar
from coview.recordings import Opening
from coview.tracks import find_sequence, number_frames, read_tracks
from toolkit.calibration.place import Place
from toolkit.runtime.run import Simulation

if TYPE_CHECKING:
    from toolkit.counting.trajectories import Trajectory
    from toolkit.exchange.track_frames import TrackFile
    from toolkit.frame import Recording
    from toolkit.sites.site import Site
    from toolkit.traffic.flow import Flow
    from toolkit.traffic.supply import Supply

FRAME_S = 0.1  # between frames of simulated traffic
FLEET_FRAMES = 100  # frames whose number of bodies is drawn for simulated traffic
SECONDS_AN_HOUR = 3600.0
STREET_SITE_ENDINGS = (".json", ".geojson")


@dataclass(frozen=True, kw_only=True)
class StreetDemand:
    """Simulated traffic, for a site in place of a recording."""

    hours: float = 1.0
    """Hours of traffic to simulate, without rays."""
    flow: str | None = None
    """Demand, as in coview simulate; drawn when left out."""
    seed: int = 0
    """Seed of the traffic."""
    stretch: float | None = None
    """Seconds of it to record with rays and to detect, which gives the errors of the sensors; none
    when left out."""


@dataclass(frozen=True, kw_only=True)
class Measuring:
    """Tracks from which road users are known."""

    detector: str = "general"
    """Detector, as in coview detect."""
    tracks: Path | None = None
    """File of coview track, instead of a detector."""
    errors: str = "paper"
    """Error profile of simulated sensors, as in coview evaluate."""
    frames: int | None = None
    """Number of first frames to use; all when left out."""


class Street(NamedTuple):
    """Road users of a street.

    Attributes:
        site: the place.
        times: time of each frame (s).
        measured: trajectories that were found, None for simulated traffic without rays.
        true: true trajectories, None for a recording without truth."""

    site: "Site"
    times: Sequence[float]
    measured: "list[Trajectory] | None"
    true: "list[Trajectory] | None"


def is_site(source: str) -> bool:
    """True for the name or file of a site, False for a recording."""
    from toolkit.sites import BUILT_IN

    path = Path(source)
    if path.exists():
        return path.is_file() and path.suffix.lower() in STREET_SITE_ENDINGS
    return source in BUILT_IN


def list_inputs(source: str, measuring: Measuring, opening: Opening) -> list[Path]:
    """Files that are read, which no output may replace."""
    tracks = [measuring.tracks] if measuring.tracks else []
    if is_site(source):
        return [*site_file(source), *tracks]
    return [Path(source), *opening.files, *tracks]


def open_street(
    source: str,
    measuring: Measuring,
    demand: StreetDemand,
    opening: Opening,
    *,
    place: Place,
    hidden: bool,
) -> tuple[Street, Street | None]:
    """Road users of a source, and of a site's stretch with rays if one is asked for.

    A recording is observed; a site's traffic is simulated for hours without rays, which gives the
    true road users. The second one is the stretch, None without.

    source: recording, or name or file of a site; measuring: how road users are tracked; demand:
    hours, flow, seed and stretch of simulated traffic; opening: how a recording is read; place:
    area and ground; hidden: True to show no progress. Raises the errors of `simulate_street` and
    `observe_street`."""
    if not is_site(source):
        if demand != StreetDemand():
            raise ValueError(
                f"--hours, --flow, --seed and --stretch are for a site, but {source} is a "
                "recording: leave them out"
            )
        return observe_street(Path(source), measuring, opening, place, hidden=hidden), None
    if measuring.tracks is not None:
        raise ValueError(f"--tracks is for a recording, but {source} is a site: leave it out")
    flow = choose_flow(source, demand)
    street = simulate_street(source, demand, flow, hidden=hidden)
    stretch = record_stretch(source, demand, flow, measuring, place=place, hidden=hidden)
    return street, stretch


def choose_flow(source: str, demand: StreetDemand) -> "Flow":
    """Read the demand of a table, or draw it.

    source: name or file of the site. Raises ValueError for numbers that do not fit."""
    from toolkit.sites.files import load_site
    from toolkit.traffic.flow import Flow
    from toolkit.traffic.ways import possible_movements

    check_positive("--hours", demand.hours)
    check_positive("--stretch", demand.stretch)
    check_least("--seed", demand.seed, 0)
    if demand.flow is not None and demand.flow != "drawn":
        return Flow.read(demand.flow)
    possible = possible_movements(load_site(source), _draw_supply(demand.seed))
    return Flow.draw(possible, np.random.default_rng([demand.seed, 1]))


def _draw_supply(seed: int) -> "Supply":
    """Bodies of simulated traffic."""
    from toolkit.bodies.fleet import fleet_named
    from toolkit.traffic.supply import Supply

    rng = np.random.default_rng([seed, 2])
    return Supply(fleet_named().bodies(FLEET_FRAMES, rng), rng, once=True)


def simulate_street(source: str, demand: StreetDemand, flow: "Flow", *, hidden: bool) -> Street:
    """Simulate the true road users of a site without rays.

    source: name or file of the site; demand: how long, and seed of the bodies; flow: road users an
    hour from each entry to each exit; hidden: True to show no progress."""
    from toolkit.sites.files import load_site
    from toolkit.traffic.continuous import simulate_continuously
    from toolkit.traffic.street_truth import list_trajectories

    seconds = demand.hours * SECONDS_AN_HOUR
    site = load_site(source)
    with progress_bar("second", int(seconds), hidden=hidden) as bar:
        traffic = simulate_continuously(
            site,
            _draw_supply(demand.seed),
            frames=round(seconds / FRAME_S) + 1,
            interval=FRAME_S,
            max_parked=0,
            flow=flow,
            progress=bar.to,
        )
    times = FRAME_S * np.arange(len(traffic))
    return Street(site, times=times.tolist(), measured=None, true=list_trajectories(traffic))


def record_stretch(
    source: str,
    demand: StreetDemand,
    flow: "Flow",
    measuring: Measuring,
    *,
    place: Place,
    hidden: bool,
) -> Street | None:
    """Record simulated traffic with rays for a while, and find its road users.

    The while is `demand.stretch` (s); returns None if the demand has none.

    source: name or file of the site; demand: duration and seed; flow: road users an hour from each
    entry to each exit; measuring: how road users are tracked; place: area and ground; hidden: True
    to show no progress."""
    from toolkit.datasets.simulation import simulate_dataset
    from toolkit.traffic.snapshots import Mix

    if demand.stretch is None:
        return None
    frames = round(demand.stretch / FRAME_S) + 1
    with TemporaryDirectory(prefix="coview-") as folder:
        path = Path(folder) / "stretch.hdf5"
        with progress_bar("frame", frames, hidden=hidden) as bar:
            run = Simulation(seed=demand.seed, frames=frames, workers=None, progress=bar.stage)
            simulate_dataset(source, path, run=run, interval=FRAME_S, mix=Mix(flow=flow))
        return observe_street(path, measuring, Opening(site=source), place, hidden=hidden)


def observe_street(
    recording: Path, measuring: Measuring, opening: Opening, place: Place, *, hidden: bool
) -> Street:
    """Find the road users of a recording, by tracks of a file or of a detector.

    hidden: True to show no progress. Raises ValueError for a recording of an unknown site, and for
    tracks of other frames."""
    from toolkit.counting.fragments import join_fragments
    from toolkit.counting.trajectories import collect_trajectories
    from toolkit.datasets.recording_views import Part

    check_least("--frames", measuring.frames, 1, "leave it out for all")
    spec = DetectorSpec.from_name(measuring.detector)
    if measuring.tracks is None:
        check_detector(spec)
    with opening.open(recording) as opened:
        site = opened.site
        if site is None:
            raise ValueError(
                f"{recording} does not say which site it shows, whose arms are counted: give --site"
            )
        if measuring.tracks is not None:
            sequence = find_sequence(recording, opening)
            track_file = read_tracks(measuring.tracks, sequence)
            samples = Part(number_frames(opened, sequence), measuring.frames)
            is_part = len(samples) < len(opened)
            return _read_street(samples, site, track_file, is_part=is_part)
        in_order = detect_in_order(
            opened,
            Detectors(spec, place),
            errors=measuring.errors,
            frames=measuring.frames,
            hidden=hidden,
        )
    tracks = in_order.track(offline=True)
    has_truth = any(len(objects) for objects in in_order.truths)
    return Street(
        site,
        in_order.times,
        measured=join_fragments(collect_trajectories(tracks, in_order.times)),
        true=collect_trajectories(in_order.truths, in_order.times) if has_truth else None,
    )


def _read_street(
    samples: "Recording", site: "Site", track_file: "TrackFile", *, is_part: bool
) -> Street:
    """Road users of a file of tracks, next to the truth of its recording.

    Args:
        samples: First frames of the recording, with the numbers that texts of tracks know them by.
        site: Its site.
        track_file: Its tracks.
        is_part: True if the recording goes on after these frames.

    Raises ValueError for times out of order or too far apart, and for tracks of other frames."""
    from toolkit.counting.fragments import join_fragments
    from toolkit.counting.trajectories import collect_trajectories
    from toolkit.exchange.track_lookup import FrameKey, TrackLookup

    keys = []
    truths = []
    for k in range(len(samples)):
        frame = samples[k]
        keys.append(FrameKey(frame.index, frame.name, frame.time))
        truths.append(frame.objects)
    times = [key.time for key in keys]
    check_times(times)
    tracks_by_frame = TrackLookup(track_file).list_tracks(keys, is_part=is_part)
    has_truth = any(len(objects) for objects in truths)
    return Street(
        site,
        times,
        measured=join_fragments(collect_trajectories(tracks_by_frame, times)),
        true=collect_trajectories(truths, times) if has_truth else None,
    )
