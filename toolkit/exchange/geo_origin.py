"""Place of the world frame on earth (WGS84), and its points in degrees.

The world's xy plane is level at the origin: x and y become metres east and north after a turn, and
earth-centred coordinates after that, so that a point 1 km away is exact although the earth is
curved."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from toolkit.arrays import Float, Float64
from toolkit.geometry import pose, transform
from toolkit.sites.georeference import longitude_latitude
from toolkit.sites.site import Site

EQUATOR_RADIUS_M = 6378137.0
WGS84_ECCENTRICITY_SQUARED = 6.69437999014e-3
_STEPS = 5  # steps of the fixed point for latitude; four give nanometres
_BASELINE_M = 100.0  # over which a site's x axis is measured on the ground


@dataclass(frozen=True)
class GeoOrigin:
    """Place of the world's 0 0 0 on earth.

    Attributes:
        latitude_deg: Degrees north, WGS84.
        longitude_deg: Degrees east, WGS84.
        turn: Direction of the world's x (rad, counter-clockwise from true east).

    Raises:
        ValueError: A number is out of range; within a degree of the poles there is no east.

    >>> GeoOrigin(48.1, 11.6).degrees(np.array([[0.0, 1000.0, 0.0]])).round(5).tolist()
    [[11.6, 48.10899]]
    """

    latitude_deg: float
    longitude_deg: float
    turn: float = 0.0

    def __post_init__(self) -> None:
        """Raise ValueError for a latitude or longitude (degrees) out of range."""
        if not abs(self.latitude_deg) <= 89:
            raise ValueError(
                f"latitude must lie within 89 degrees of the equator, got {self.latitude_deg:g}"
            )
        if not abs(self.longitude_deg) <= 180:
            raise ValueError(
                f"longitude must lie within 180 degrees of Greenwich, got {self.longitude_deg:g}"
            )

    @staticmethod
    def from_site(site: Site | None) -> "GeoOrigin | None":
        """Return the place of a site's frame, None if it is unknown.

        Raises the errors of `toolkit.sites.georeference.longitude_latitude`."""
        if site is None:
            return None
        # the world's origin, and a point along its x axis
        places = longitude_latitude(site, np.array([[0.0, 0.0], [_BASELINE_M, 0.0]]))
        if places is None:
            return None
        longitude, latitude = places[0].tolist()
        unturned_origin = GeoOrigin(latitude, longitude)
        x_axis = unturned_origin._metres_towards(places[1])  # east, north, up (m)
        return GeoOrigin(latitude, longitude, float(np.arctan2(x_axis[1], x_axis[0])))

    def degrees(self, points: Float[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2"]:
        """Return longitude and latitude (degrees) of points of the world frame (m)."""
        # `turn` is the angle from east to the world's x axis
        east_north_up = transform(pose(yaw=self.turn), np.asarray(points, np.float64))
        origin = _earth_centred(self.latitude_deg, self.longitude_deg)
        x, y, z = (east_north_up @ self._axes() + origin).T  # earth-centred (m)
        longitude = np.arctan2(y, x)
        axis_distance = np.hypot(x, y)
        # fixed point of the geodetic latitude: the normal meets earth's axis below the equator
        latitude = np.arctan2(z, axis_distance * (1 - WGS84_ECCENTRICITY_SQUARED))
        for _ in range(_STEPS):
            sine = np.sin(latitude)
            depth_below_equator = WGS84_ECCENTRICITY_SQUARED * _normal_radius(sine) * sine
            latitude = np.arctan2(z + depth_below_equator, axis_distance)
        return np.rad2deg(np.column_stack([longitude, latitude]))

    def bearings_deg(self, yaws: Float[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Return compass bearings (degrees in 0..360, clockwise from true north) of yaws.

        yaws: rad, counter-clockwise from the world's x."""
        return (90.0 - np.rad2deg(np.asarray(yaws, np.float64) + self.turn)) % 360.0

    def _axes(self) -> Float64[np.ndarray, "3 3"]:
        """Unit vectors east, north and up at the origin, a row each, in earth-centred x, y, z."""
        latitude = np.deg2rad(self.latitude_deg)
        longitude = np.deg2rad(self.longitude_deg)
        sine = np.sin(latitude)
        cosine = np.cos(latitude)
        east = [-np.sin(longitude), np.cos(longitude), 0.0]
        north = [-sine * np.cos(longitude), -sine * np.sin(longitude), cosine]
        up = [cosine * np.cos(longitude), cosine * np.sin(longitude), sine]
        return np.array([east, north, up])

    def _metres_towards(self, place: Float64[np.ndarray, "2"]) -> Float64[np.ndarray, "3"]:
        """Metres east, north and up from the origin to a place.

        place: its longitude and latitude (degrees)."""
        longitude_deg, latitude_deg = place
        offset = _earth_centred(latitude_deg, longitude_deg) - _earth_centred(
            self.latitude_deg, self.longitude_deg
        )
        return self._axes() @ offset


def _normal_radius(sine: Any) -> Any:
    """Radius of curvature (m) across the meridian at the sine of a latitude, or of several."""
    return EQUATOR_RADIUS_M / np.sqrt(1 - WGS84_ECCENTRICITY_SQUARED * sine**2)


def _earth_centred(latitude_deg: float, longitude_deg: float) -> Float64[np.ndarray, "3"]:
    """Earth-centred x, y, z (m) of a place on the ellipsoid: z to the north pole, x to 0° 0°."""
    latitude = np.deg2rad(latitude_deg)
    longitude = np.deg2rad(longitude_deg)
    radius = _normal_radius(np.sin(latitude))
    x = radius * np.cos(latitude) * np.cos(longitude)
    y = radius * np.cos(latitude) * np.sin(longitude)
    z = radius * (1 - WGS84_ECCENTRICITY_SQUARED) * np.sin(latitude)
    return np.array([x, y, z])
