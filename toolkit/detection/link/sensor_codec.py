"""`SensorCodec`: frames of one sensor as messages, and messages as frames again.

This is the stable interface for other programs: `encode(frame)` gives bytes, `decode(message)` a
frame. Sender and centre hold the same codec. docs/reference/message-format.md specifies the bytes
for readers in other languages."""

from dataclasses import dataclass, field

from toolkit.calibration.empty_scene import EmptyScene
from toolkit.detection.link.foreground import Foreground, decode_foreground, encode_in_packet
from toolkit.detection.link.foreground_pixels import standing_out
from toolkit.detection.view import Captured
from toolkit.frame import Frame
from toolkit.objects import Objects
from toolkit.points import Area
from toolkit.sensors.sensor import Sensor


@dataclass(frozen=True, eq=False)
class SensorCodec:
    """Codec of the foreground of one sensor. Raises ValueError for the scene of another sensor.

    Attributes:
        sensor: the sensor, at the pose that the centre assumes.
        scene: its image without road users (`toolkit.calibration.empty_scene`).
        area: detection area, a site or xmin, ymin, xmax, ymax (m); nothing outside it is sent.
        scheme: steps and threshold of the foreground.
    """

    sensor: Sensor
    scene: EmptyScene
    area: Area
    scheme: Foreground = field(default_factory=Foreground)

    def __post_init__(self) -> None:
        """Raise ValueError for the scene of another sensor."""
        if (self.sensor.name, self.sensor.model) != (self.scene.name, self.scene.model):
            raise ValueError(
                f"the empty scene must be of {self.sensor.name!r}, {self.sensor.model}, got one of "
                f"{self.scene.name!r}, {self.scene.model}"
            )

    def encode(self, frame: Frame) -> bytes:
        """Return the message of this sensor for a frame.

        The message has the frame's time and number, and fits one packet of the radio whenever some
        step of the scheme allows. Raises ValueError if the frame lacks the sensor, or has a cloud
        of it in place of an image (`toolkit.calibration.cloud_image.rasterize_cloud` makes one)."""
        captured = Captured(frame.seen_by([self.sensor.name]), 0, self.area)
        foreground = standing_out(captured, self.scene, self.scheme.sigmas)
        return encode_in_packet(
            captured.sending(foreground.pixels),
            self.scene,
            foreground.missing,
            step=self.scheme.step,
            max_step=self.scheme.max_step,
        )

    def decode(self, message: bytes) -> Frame:
        """Return the frame that the centre restores from a message, without objects.

        Its image has the measurements that were sent (m, within half a step), 0 in missing pixels,
        and the empty scene in all others; `Frame.points` makes points of it. Raises ValueError for
        a message that is damaged, of another version or sensor, or made with another scene."""
        restored = decode_foreground(message, self.scene)
        return Frame(
            sensors=(self.sensor,),
            measurements=(restored.image,),
            objects=Objects.empty(),
            time=restored.header.time,
            index=restored.header.number,
        )
