"""Simulated junctions as an input: traffic that goes on, rendered as it is needed."""

from collections.abc import Iterator
from dataclasses import dataclass
from threading import Event

from toolkit.bodies.fleet import fleet_named
from toolkit.centre.sensor_message import SensorMessage, list_messages
from toolkit.datasets.recording_views import with_errors
from toolkit.datasets.simulation import Job
from toolkit.sensors.sensor import Sensor
from toolkit.sites.site import Site

_ERRORS = "paper"  # noise of the sensors


@dataclass(frozen=True, eq=False)
class JunctionInput:
    """Junction with simulated traffic, seen by its sensors.

    Attributes:
        site: Site with sensors.
        interval_s: Time between frames (s), a whole number of tenths.
        seconds: Time after which it ends (s).
        seed: Seed of traffic and noise.
    """

    site: Site
    interval_s: float = 0.1
    seconds: float = 600.0
    seed: int = 0
    is_live = False

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """Sensors of the site."""
        return self.site.sensors

    def messages(self, stop: Event) -> Iterator[SensorMessage]:
        """Simulate the traffic, then yield the messages of frame after frame.

        Raises the errors of `toolkit.traffic.ways.simulate_ways`."""
        job = Job(
            self.site,
            self.sensors,
            fleet_named(),
            frames=max(2, round(self.seconds / self.interval_s)),
            seed=self.seed,
            interval=self.interval_s,
        ).with_traffic()
        make_scenes = job.start(1)  # in one process; gives the scenes of a block
        for block in range(job.blocks):
            for scene in make_scenes(block):
                if stop.is_set():
                    return
                yield from list_messages(with_errors(scene.frame, _ERRORS, self.seed))
