"""`RecordingScenes`: the empty scenes of a recording's sensors, learnt when the first of them is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

from toolkit.calibration.empty_scene import EmptyScene, learn_empty_scenes
from toolkit.datasets.readings import Readable
from toolkit.sensors.errors.profile import ErrorProfile
from toolkit.sensors.errors.profiles import PAPER_ERRORS


class RecordingScenes:
    """The empty scene of a sensor (index). given: in place of what the recording itself shows, in any order, found by
    the sensors' names; errors, noise_seed: of the sensors.

    Raises ValueError, when asked, where one of a sensor is missing.
    """

    def __init__(
        self,
        recording: Readable,
        given: Sequence[EmptyScene] | None = None,
        *,
        errors: ErrorProfile | str = PAPER_ERRORS,
        noise_seed: int | None = 0,
    ) -> None:
        self._recording, self._given, self._errors, self._noise_seed = recording, given, errors, noise_seed
        self.used = False

    def __call__(self, sensor: int) -> EmptyScene:
        """Of the sensor with this index."""
        self.used = True
        return self._scenes[sensor]

    @property
    def digests(self) -> list[str]:
        """Of the scenes of all sensors, for results to say; none where nobody asked for a scene."""
        return [scene.digest for scene in self._scenes] if self.used else []

    @cached_property
    def _scenes(self) -> tuple[EmptyScene, ...]:
        if self._given is None:
            return learn_empty_scenes(self._recording, errors=self._errors, noise_seed=self._noise_seed)
        by_name = {scene.name: scene for scene in self._given}
        sensors = self._recording[0].sensors
        missing = [sensor.name for sensor in sensors if sensor.name not in by_name]
        if missing:
            raise ValueError(
                f"there are empty scenes of {', '.join(by_name)}, none of {', '.join(missing)}: learn them"
            )
        return tuple(by_name[sensor.name] for sensor in sensors)
