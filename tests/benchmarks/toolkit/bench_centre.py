"""A running centre: latency of every frame at the recording's own pace, faults named, memory.

    python tests/benchmarks/toolkit/bench_centre.py [--sites tjunction roundabout] [--frames 1000]
        [--minutes 0] [--detect-every 1] [--parallel 1] [--deadline 0.08] [--no-pace] [--no-faults]
        [--threads] [--plot latency.png] [--folder recordings]

Street traffic is simulated at 10 Hz at the T-junction and at 5 Hz at the roundabout, unless the
folder has it. It is replayed at its own pace through `coview run`'s parts with the site's network,
its background, and tracks written to MCAP. Then a sensor falls silent, one is delayed
by 300 ms, and one is turned by 2 degrees about each axis, each in a run of its own.

--minutes repeats the recording for so long, for the growth of memory. --detect-every 2 detects in
every second frame, and so on. --parallel 2 detects in two frames at the same time. --deadline is
the time (s) after which a frame is out without its detections; 10 waits for them. --threads reads
the recording by a thread of the centre's process instead of a process, to see what that is for.
Times depend on what else the machine does, and on OMP_NUM_THREADS.
"""

import argparse
import heapq
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from threading import Event

import numpy as np

from coview.commands.detection.centre_parts import open_centre
from tests.benchmarks.figures import SITE_TITLES, record
from toolkit.centre.centre_config import CentreConfig, InputConfig, OutputConfig
from toolkit.centre.centre_run import run_centre
from toolkit.centre.detection_pool import DEADLINE_S
from toolkit.centre.health import HealthLog, read_memory_mb
from toolkit.centre.input_pumps import read_in_thread
from toolkit.centre.recording_input import RecordingInput
from toolkit.centre.running_centre import CentreEvent, CentreFrame
from toolkit.centre.sensor_message import SensorMessage
from toolkit.centre.sensor_watch import FaultEvent
from toolkit.datasets.recording_views import ReadRecording, Reads
from toolkit.datasets.recordings import open_recording
from toolkit.datasets.simulation import simulate_dataset
from toolkit.runtime.run import Simulation
from toolkit.sensors.sensor import Sensor
from toolkit.sites.files import load_site

INTERVALS_S = {"tjunction": 0.1, "roundabout": 0.2}
MAX_LATENCY_MS = 120.0
MIN_SHARE = 0.995
SEED = 31
DELAY_S = 0.3
TURN_RAD = np.deg2rad(2.0)
ONSET_S = 10.0  # from the start to the fault
NAMING_S = {"silent": 0.5, "late": 0.5, "shifted": 30.0}
FAILING = "d2"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sites", nargs="+", default=["tjunction", "roundabout"])
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--minutes", type=float, default=0.0)
    parser.add_argument("--detect-every", type=int, default=1)
    parser.add_argument("--parallel", type=int, default=1)
    parser.add_argument("--deadline", type=float, default=DEADLINE_S)
    parser.add_argument("--no-pace", action="store_true")
    parser.add_argument("--no-faults", action="store_true")
    parser.add_argument("--threads", action="store_true")
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args()
    latencies = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        for site in options.sites:
            path = simulate_street(site, options.frames, folder)
            if not options.no_pace:
                latencies[site] = measure_pace(site, path, Path(temporary), options)
            if not options.no_faults:
                for name in ("silent", "late"):
                    time_naming(site, path, name, FAULTS[name])
                for axis in range(3):
                    turned = simulate_turned(site, axis, options.frames, folder)
                    time_naming(site, path, "shifted", partial(Turned, turned_path=turned))
    if options.plot is not None:
        plot_latencies(latencies, options.plot)


def simulate_street(
    site: str,
    frames: int,
    folder: Path,
    suffix: str = "",
    sensors: tuple[Sensor, ...] | None = None,
) -> Path:
    """Simulate a street, unless the folder has it."""
    path = folder / f"{site}{suffix}-{frames}.hdf5"
    run = Simulation(frames=frames, seed=SEED, workers=None)
    simulate_dataset(site, path, interval=INTERVALS_S[site], run=run, sensors=sensors)
    return path


def simulate_turned(site: str, axis: int, frames: int, folder: Path) -> Path:
    """Simulate the same street as the failing sensor sees it, turned about an axis."""
    sensor = next(row for row in load_site(site).sensors if row.name == FAILING)
    world_SE3_turned = sensor.pose.copy()
    world_SE3_turned[:3, :3] = turn_about(axis, TURN_RAD) @ sensor.pose[:3, :3]
    turned = Sensor(sensor.name, sensor.model, world_SE3_turned)
    return simulate_street(site, frames, folder, f"-turned-{'xyz'[axis]}", (turned,))


def turn_about(axis: int, angle: float) -> np.ndarray:
    """Matrix of a turn about an axis of the world."""
    turn = np.eye(3)
    i, j = ((1, 2), (2, 0), (0, 1))[axis]
    turn[i, i] = turn[j, j] = np.cos(angle)
    turn[i, j], turn[j, i] = -np.sin(angle), np.sin(angle)
    return turn


def configure(site: str, path: Path, folders: dict[str, Path]) -> CentreConfig:
    """Configuration of a centre at a site."""
    return CentreConfig(
        (InputConfig("recording", path=path, layout="hdf5"),),
        detector=f"{site}+background",
        output=OutputConfig(folders),
    )


def measure_pace(site: str, path: Path, folder: Path, options: argparse.Namespace) -> list[float]:
    """Print what the centre does at the recording's own pace; return latencies (ms)."""
    latencies = []
    memory_mb = []

    def show(frame: CentreFrame) -> None:
        latencies.append(frame.latency_ms)
        memory_mb.append(read_memory_mb())

    config = configure(site, path, {"mcap": folder / f"{site}-tracks"})
    config = replace(
        config,
        detect_every=options.detect_every,
        parallel=options.parallel,
        deadline_s=options.deadline,
    )
    with open_centre(config) as parts:
        if options.minutes:
            (recorded,) = parts.inputs
            assert isinstance(recorded, RecordingInput)
            parts = replace(parts, inputs=[Repeated(recorded, parts.interval_s)])
        if options.threads:
            parts = replace(parts, read=read_in_thread)
        seconds = 60 * options.minutes or None
        figures = run_centre(
            parts, HealthLog(None), Event(), seconds=seconds, show=show, report=print
        )
    expected = options.frames if not options.minutes else figures["frames"]
    in_time = float(np.sum(np.array(latencies) <= MAX_LATENCY_MS) / expected)
    verdict = "" if in_time >= MIN_SHARE and not figures["dropped_frames"] else "  MISSED"
    print(
        f"{site}: {figures['frames']} of {expected} frames out, {figures['dropped_frames']} "
        f"dropped, {figures['predicted_frames']} with predicted tracks "
        f"({figures['late_detections']} detected later), {100 * in_time:.2f} % within "
        f"{MAX_LATENCY_MS:g} ms{verdict}"
    )
    for stage, row in figures["ms"].items():
        print(
            f"  {stage:13} median {row['median']:6.1f}  p95 {row['p95']:6.1f}  p99 "
            f"{row['p99']:6.1f}"
        )
    tenth = max(1, len(memory_mb) // 10)
    hours = parts.interval_s * np.arange(len(memory_mb)) / 3600
    slope = float(np.polyfit(hours[tenth:], memory_mb[tenth:], 1)[0])
    print(
        f"  memory {memory_mb[tenth]:.0f} MB after a tenth, {memory_mb[-1]:.0f} MB at the end, "
        f"{slope:+.0f} MB an hour"
    )
    print(f"  false alarms {figures['faults']}", flush=True)
    latency_ms = figures["ms"]["latency"]
    cells = [
        f"{figures['frames']}/{expected}",
        f"{figures['predicted_frames']}",
        f"{figures['late_detections']}",
        f"{100 * in_time:.1f} %",
        "/".join(f"{latency_ms[name]:.0f}" for name in ("median", "p95", "p99")),
        f"{figures['ms']['detect']['median']:.0f}",
    ]
    record("centre", f"{SITE_TITLES[site]}, {1 / INTERVALS_S[site]:g} Hz", cells, network="`site`")
    return latencies


def time_naming(
    site: str, path: Path, fault: str, break_input: Callable[[RecordingInput], "Broken"]
) -> None:
    """Print how soon a fault of one sensor is named, and what the other sensors did meanwhile."""
    events: list[FaultEvent] = []
    stop = Event()

    def report(event: CentreEvent) -> None:
        if not isinstance(event, FaultEvent):
            return
        events.append(event)
        if event.sensor == FAILING and event.fault and event.fault.value == fault:
            stop.set()

    with open_centre(configure(site, path, {})) as parts:
        (recorded,) = parts.inputs
        assert isinstance(recorded, RecordingInput)
        source = break_input(recorded)
        seconds = ONSET_S + NAMING_S[fault] + 5
        figures = run_centre(
            replace(parts, inputs=[source]), HealthLog(None), stop, seconds=seconds, report=report
        )
    named = [row for row in events if row.sensor == FAILING and row.fault]
    times = {row.fault.value: round(row.time_s - source.onset_s, 2) for row in reversed(named)}
    others = [str(row) for row in events if row.sensor != FAILING]
    soon = times.get(fault, np.inf) <= NAMING_S[fault]
    print(
        f"{site}: {source.title}: named after {times} s{'' if soon else '  MISSED'}; "
        f"{figures['frames']} frames, other events {others}",
        flush=True,
    )


@dataclass(frozen=True, eq=False)
class Broken:
    """Input of which one sensor fails from a time on."""

    source: RecordingInput
    is_live = False
    title = ""

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        return self.source.sensors

    @property
    def onset_s(self) -> float:
        return float(self.source.recording[0].time + ONSET_S)

    def messages(self, stop: Event) -> Iterator[SensorMessage]:
        raise NotImplementedError

    def fails(self, message: SensorMessage) -> bool:
        return message.sensor == FAILING and message.time_s >= self.onset_s - 1e-6


class Silent(Broken):
    """Input of which one sensor falls silent."""

    title = "silent"

    def messages(self, stop: Event) -> Iterator[SensorMessage]:
        return (row for row in self.source.messages(stop) if not self.fails(row))


class Late(Broken):
    """Input of which the messages of one sensor are delayed."""

    title = f"late by {DELAY_S:g} s"

    def messages(self, stop: Event) -> Iterator[SensorMessage]:
        waiting: list[tuple[float, int, SensorMessage]] = []
        for number, message in enumerate(self.source.messages(stop)):
            while waiting and waiting[0][0] <= message.arrival_s:
                yield heapq.heappop(waiting)[2]
            if self.fails(message):
                message = replace(message, arrival_s=message.arrival_s + DELAY_S)
                heapq.heappush(waiting, (message.arrival_s, number, message))
            else:
                yield message


@dataclass(frozen=True, eq=False)
class Turned(Broken):
    """Input of which one sensor is turned, as another recording shows it."""

    turned_path: Path = Path()

    @property
    def title(self) -> str:  # type: ignore[override]
        return f"turned by 2 degrees about {self.turned_path.stem.split('-')[-2]}"

    def messages(self, stop: Event) -> Iterator[SensorMessage]:
        turned = ReadRecording(open_recording(self.turned_path, "hdf5"), Reads())
        other_messages = RecordingInput(turned).messages(stop)
        for message in self.source.messages(stop):
            if message.sensor == FAILING:
                other = next(other_messages)
                message = other if self.fails(message) else message
            yield message


FAULTS: dict[str, type[Broken]] = {"silent": Silent, "late": Late}


@dataclass(frozen=True, eq=False)
class Repeated:
    """Input that repeats a recording for ever, with times that go on."""

    source: RecordingInput
    interval_s: float
    is_live = False

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        return self.source.sensors

    def messages(self, stop: Event) -> Iterator[SensorMessage]:
        offset_s = 0.0
        while not stop.is_set():
            for message in self.source.messages(stop):
                yield replace(
                    message,
                    time_s=message.time_s + offset_s,
                    arrival_s=message.arrival_s + offset_s,
                )
            offset_s += len(self.source.recording) * self.interval_s


def plot_latencies(latencies: dict[str, list[float]], out: Path) -> None:
    """Draw the share of frames that are out by a latency."""
    from toolkit.plots.canvas import house_style, write_figure
    from toolkit.plots.curves import curve_axes, name_curves
    from toolkit.plots.palette import FAINT

    with house_style():
        figure, axes = curve_axes("From the last point to the written tracks", len(latencies))
        longest_ms = MAX_LATENCY_MS
        for values in latencies.values():
            ordered = np.sort(values)
            axes.plot(ordered, 100 * np.arange(1, len(ordered) + 1) / len(ordered))
            longest_ms = max(longest_ms, ordered[-1])
        axes.axvline(MAX_LATENCY_MS, color=FAINT, linestyle="--")
        axes.text(MAX_LATENCY_MS, 4.0, f" {MAX_LATENCY_MS:g} ms")
        axes.set_xlim(0.0, 1.15 * longest_ms)
        axes.set_ylim(0.0, 101.0)
        axes.set_xlabel("latency (ms)")
        axes.set_ylabel("frames that are out (%)")
        names = [
            f"{SITE_TITLES[site]}, {1 / INTERVALS_S[site]:g} Hz, {len(values):,} frames"
            for site, values in latencies.items()
        ]
        name_curves(axes, names)
        write_figure(figure, out)


if __name__ == "__main__":
    main()
