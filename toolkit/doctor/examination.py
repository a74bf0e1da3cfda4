"""Agreement of points and boxes in a file of images, with and without suspected mistakes.

The fit is the share of moving points that are on boxes (`toolkit.doctor.moving_points`). Rows are
published ones, a table for each frame, in CARLA's frame."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from toolkit.datasets import published_layout as published
from toolkit.doctor.findings import Finding, report_error
from toolkit.doctor.frame_shifts import suspect_frames
from toolkit.doctor.moving_points import choose_witnesses, collect_clouds
from toolkit.doctor.sensor_images import SensorImages
from toolkit.doctor.site_area import find_misplaced
from toolkit.doctor.stored_objects import suspect_objects
from toolkit.doctor.stored_sensors import suspect_sensor
from toolkit.doctor.suspicions import MIN_MOVING_POINTS, Suspicion
from toolkit.objects import Objects
from toolkit.sites.site import Site

MIN_SENSOR_FIT = 0.5  # share of a sensor's moving points on boxes, for its pose to be certain
SAMPLED_FRAMES = 20  # frames whose objects and points are compared with the ground and the site


class Examination:
    """Suspected mistakes in the objects and the sensors of a file of images.

    Args of the constructor: `site` of the file; `views`, the images of each sensor in the frames
    that are looked at; `tables`, the published rows of all frames of the file; `frames`, numbers of
    the frames that are looked at.

    Attributes:
        site: site of the file.
        views: images of each sensor.
        mistakes: suspected mistakes in the objects.
        explained_count: number of moving points on boxes, once these mistakes are undone.
        misplaced_findings: findings of objects that are not at the site.
        rows: published rows of each frame looked at, without all those mistakes.
        doubts: by name of a sensor in doubt, the suspected mistake of its pose or depth; None if
            its points disagree with the boxes without an explanation.
        fits: share of each sensor's moving points on boxes, by its name, if they are enough."""

    def __init__(
        self,
        site: Site,
        views: Sequence[SensorImages],
        tables: Sequence[np.ndarray],
        frames: Sequence[int],
    ) -> None:
        """Look for mistakes in the objects first, then in each sensor, with those undone.

        Args:
            site: site of the recording.
            views: each sensor, with its images of the examined frames.
            tables: published rows of the objects of all frames of the file.
            frames: numbers, in the file, of the examined frames."""
        self.site = site
        self.views = views
        sensors = [view.sensor for view in views]
        witnesses = choose_witnesses(views)  # moving pixels of each sensor and frame
        clouds = collect_clouds(witnesses, sensors, len(frames))
        frame_shift, rows = suspect_frames(clouds, tables, frames, site.map_SE3_site)
        undone = suspect_objects(witnesses, sensors, rows, site.map_SE3_site)
        self.mistakes = [frame_shift] if frame_shift else []
        self.mistakes += undone.suspicions
        # the fit is the share of all moving points
        self.explained_count = undone.fit * sum(len(witness.depth) for witness in witnesses)
        self.misplaced_findings, self.rows = find_misplaced(undone.rows, site)
        # by sensor that fits badly: its likely mistake, None if no mistake explains it
        self.doubts: dict[str, Suspicion | None] = {}
        self.fits: dict[str, float] = {}  # share of a sensor's moving points on boxes
        for index, sensor in enumerate(sensors):
            sensor_witnesses = [witness for witness in witnesses if witness.sensor_index == index]
            point_count = sum(len(witness.depth) for witness in sensor_witnesses)
            # too few points, or no objects, show nothing of the sensor
            if point_count < MIN_MOVING_POINTS or not any(len(table) for table in self.rows):
                continue
            suspicion, sensor_fit = suspect_sensor(
                sensor_witnesses, sensor, self.rows, site.map_SE3_site
            )
            self.fits[sensor.name] = sensor_fit
            if suspicion is not None or sensor_fit < MIN_SENSOR_FIT:
                self.doubts[sensor.name] = suspicion

    def disagreements(self) -> Iterator[Finding]:
        """Yield suspected mistakes: objects first, then sensors.

        Sensors with the same mistake share a finding."""
        for mistake in self.mistakes:
            yield report_error(
                where="objects",
                suspected=mistake.mistake,
                evidence=mistake.evidence,
                remedy=mistake.remedy,
            )
        yield from self.misplaced_findings
        # suspicions by sensor for each mistake in order; "" for sensors without an explanation
        doubts_by_mistake: dict[str, dict[str, Suspicion | None]] = {}
        for name, suspicion in self.doubts.items():
            words = "" if suspicion is None else suspicion.mistake
            doubts_by_mistake.setdefault(words, {})[name] = suspicion
        for doubts in doubts_by_mistake.values():  # one mistake's suspicions by sensor
            plural = "s" if len(doubts) > 1 else ""
            where = f"sensor{plural} {', '.join(doubts)}"
            evidence = self._describe_evidence(doubts)
            suspicion = next(iter(doubts.values()))  # all these sensors have its words
            if suspicion is not None:
                yield report_error(
                    where=where,
                    suspected=suspicion.mistake,
                    evidence=evidence,
                    remedy=suspicion.remedy,
                )
            else:
                remedy = "check the pose, and that images and objects belong to the same frames"
                yield report_error(
                    where=where,
                    suspected="points and boxes disagree",
                    evidence=evidence,
                    remedy=remedy,
                )

    def _describe_evidence(self, doubts: Mapping[str, Suspicion | None]) -> str:
        """Describe the fits of sensors in doubt in words, each after its name if they are several.

        doubts: suspected mistake by name of the sensor, None without an explanation."""
        texts: dict[str, str] = {}
        for name, doubt in doubts.items():
            if doubt is None:
                texts[name] = f"{self.fits[name]:.0%} of the moving points lie on boxes"
            else:
                texts[name] = doubt.evidence
        if len(texts) == 1:
            return next(iter(texts.values()))
        return "; ".join(f"{name}: {text}" for name, text in texts.items())

    def sample_clouds(self) -> Iterator[tuple[Objects, np.ndarray]]:
        """Yield objects and points (m, site frame) of about `SAMPLED_FRAMES` frames, evenly spread.

        Points of sensors in doubt are left out."""
        trusted_views = [view for view in self.views if view.sensor.name not in self.doubts]
        step = max(1, len(self.rows) // SAMPLED_FRAMES)
        # frame: row in the images and tables, not its number in the file
        for frame in range(0, len(self.rows), step):
            objects = published.parse_rows(self.rows[frame], self.site.map_SE3_site)
            points = [view.points(frame) for view in trusted_views]
            yield objects, np.concatenate([np.zeros((0, 3), np.float32), *points])
