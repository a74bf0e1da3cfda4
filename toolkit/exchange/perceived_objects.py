"""Road users as PerceivedObject of ETSI's collective perception (TS 103 324 V2.1.1).

- `position` is the centre of the box in metres east, north and up from the reference position, in
  centimetres; `velocity` has x and y only.
- `zAngle` is the yaw, counter-clockwise from east. Sizes are along the box's axes: x is its length.
- The class has the score as its confidence in per cent, and so has `objectPerceptionQuality` in
  fifteenths. A vehicle is a passenger car, heavy a heavy truck, a pedestrian an ordinary one.
- Accuracies are unknown and sent so. Unknown velocities and ages are left out."""

from typing import Any

import numpy as np

from toolkit.arrays import Float64
from toolkit.datasets.problem_kinds import Problems, add_problem
from toolkit.exchange.instant import Instant
from toolkit.exchange.message_numbers import NumberRange, encode_angles, round_up
from toolkit.geometry import pose, transform
from toolkit.objects import LABELS

COORDINATE_M = NumberRange(
    unit=0.01,
    below=-131_072,
    above=131_071,
    problem="coordinates over 1310 m from the reference position, sent as out of range",
)
VELOCITY_M_S = NumberRange(
    unit=0.01, below=-16_383, above=16_382, problem="velocities over 163 m/s, sent as out of range"
)
DIMENSION_M = NumberRange(
    unit=0.1,
    below=0,
    above=255,
    problem="lengths, widths or heights over 25.4 m, sent as out of range",
)
UNKNOWN_COORDINATE_ACCURACY = 4096
UNKNOWN_VELOCITY_ACCURACY = 127
UNKNOWN_ANGLE_ACCURACY = 127
UNKNOWN_DIMENSION_ACCURACY = 32
MAX_AGE_S = 1.5  # sent for all that is older, too
MAX_QUALITY = 15
CLIPPED_SCORES = "scores outside 0 to 1, clipped"
ItsValue = dict[str, Any]  # a SEQUENCE of ASN.1 as asn1tools takes it
_CLASSES: dict[str, tuple[str, Any]] = {  # ObjectClass by our label
    "vehicle": ("vehicleSubClass", 5),  # passengerCar
    "cyclist": ("vruSubClass", ("bicyclistAndLightVruVehicle", 1)),  # bicyclist
    "pedestrian": ("vruSubClass", ("pedestrian", 1)),  # ordinary-pedestrian
    "heavy": ("vehicleSubClass", 8),  # heavyTruck
}


def describe_objects(
    instant: Instant, numbers: list[int], turn: float, problems: Problems
) -> list[ItsValue]:
    """Return each road user of an instant as a PerceivedObject.

    Args:
        instant: Instant with ids.
        numbers: Number of each road user, 0 to 65,535.
        turn: Direction of the world's x (rad, counter-clockwise from east).
        problems: Values beyond the standard's ranges are counted in it.
    """
    world_turn = pose(yaw=turn)
    centres = COORDINATE_M.encode(transform(world_turn, instant.boxes[:, :3]), problems).tolist()
    # a flat box has the least size, as all sizes are rounded up
    lengths = np.maximum(instant.boxes[:, 3:6], DIMENSION_M.unit)
    sizes = DIMENSION_M.encode(lengths, problems).tolist()
    angles = encode_angles(instant.boxes[:, 6] + turn).tolist()
    scores = np.clip(instant.scores, 0.0, 1.0)
    add_problem(problems, CLIPPED_SCORES, int((scores != instant.scores).sum()))
    qualities = round_up(scores, 1 / MAX_QUALITY).tolist()
    confidences = np.maximum(round_up(scores, 0.01), 1).tolist()
    velocities = _encode_velocities(instant, world_turn, problems)
    ages: list[int] | None = None
    if instant.ages is not None:
        ages = round_up(np.minimum(instant.ages, MAX_AGE_S), 0.001).tolist()
    objects = []
    for row, number in enumerate(numbers):
        perceived: ItsValue = {
            "objectId": number,
            "measurementDeltaTime": 0,
            "position": {
                f"{axis}Coordinate": _with_confidence(coordinate, UNKNOWN_COORDINATE_ACCURACY)
                for axis, coordinate in zip("xyz", centres[row], strict=True)
            },
            "angles": {"zAngle": _with_confidence(angles[row], UNKNOWN_ANGLE_ACCURACY)},
            "objectPerceptionQuality": qualities[row],
            "classification": [
                {
                    "objectClass": _CLASSES[LABELS[instant.labels[row]]],
                    "confidence": confidences[row],
                }
            ],
        }
        for axis, size in zip("XYZ", sizes[row], strict=True):
            perceived[f"objectDimension{axis}"] = _with_confidence(size, UNKNOWN_DIMENSION_ACCURACY)
        velocity = velocities[row]
        if velocity is not None:
            perceived["velocity"] = velocity
        if ages is not None:
            perceived["objectAge"] = ages[row]
        objects.append(perceived)
    return objects


def _encode_velocities(
    instant: Instant, world_turn: Float64[np.ndarray, "4 4"], problems: Problems
) -> list[tuple[str, ItsValue] | None]:
    """Return the velocity of each road user as Velocity3dWithConfidence, None if unknown.

    world_turn: rotation from the world's axes to east and north."""
    velocities: list[tuple[str, ItsValue] | None] = []
    for velocity in instant.known_velocities():
        if velocity is None:
            velocities.append(None)
            continue
        east_north_up = transform(world_turn, np.array(velocity))  # m/s
        x, y = VELOCITY_M_S.encode(east_north_up[:2], problems).tolist()
        components = {
            "xVelocity": _with_confidence(x, UNKNOWN_VELOCITY_ACCURACY),
            "yVelocity": _with_confidence(y, UNKNOWN_VELOCITY_ACCURACY),
        }
        velocities.append(("cartesianVelocity", components))
    return velocities


def _with_confidence(value: int, confidence: int) -> ItsValue:
    """Return a number with its accuracy."""
    return {"value": value, "confidence": confidence}
