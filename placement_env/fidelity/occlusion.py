"""View of sensors on every frame, ray by ray. Each silhouette is cast once, and once while a
vehicle stands still.

Silhouettes: pixels of many sensors that meet an object, from one cast of rays.

As in `toolkit.rendering.renderer`, only the rays in the window of a body's box are cast. Here the
windows of all sensors go into one call, and rays that end before they can reach the box are left
out."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from placement_env.fidelity.traffic import Traffic, scored
from toolkit.arrays import BoxRows, Float32, Float64, Int64, Mask
from toolkit.geometry import level_rows
from toolkit.objects import VEHICLE
from toolkit.points import Crop, is_inside
from toolkit.rendering.renderer import Renderer
from toolkit.rendering.strips import counting
from toolkit.sensors.sensor import NEAR, Sensor, SensorModel, nearest
from toolkit.sites.site import Site

BOXES_TOGETHER = 512  # boxes whose windows are found together


class Silhouette(NamedTuple):
    """Pixels that meet one object in front of the static scene, one row per pixel.

    Attributes:
        pixels: Numbers among the pixels of all sensors, as rows of `SensorRays.rays`.
        sensors: Index of each pixel's sensor.
        depth: Measurement of the object (m).
        points: Points on the object (m, world frame)."""

    pixels: Int64[np.ndarray, " n"]
    sensors: Int64[np.ndarray, " n"]
    depth: Float32[np.ndarray, " n"]
    points: Float32[np.ndarray, "n 3"]


class Windows(NamedTuple):
    """Rectangles of pixels around one box in the images of all sensors.

    A sensor that cannot meet the box has no rectangle; a spinning lidar has two across its seam.

    Attributes:
        rows: Columns sensor index, top, bottom, left, right (pixels, ends excluded).
        least: Lower bound of each sensor's measurement of the box (m)."""

    rows: Int64[np.ndarray, "m 5"]
    least: Float32[np.ndarray, " sensors"]


class Chances(NamedTuple):
    """Chances of points, 0 to 1.

    Attributes:
        sent: Chance that a point is sent.
        far: Chance that it is sent and beyond the site's hybrid radius."""

    sent: Float32[np.ndarray, " n"]
    far: Float32[np.ndarray, " n"]


class SensorRays:
    """Rays of sensors and what they measure at the empty site.

    Pixels are numbered sensor after sensor, and row after row in an image.

    Attributes:
        sensors: Sensors, in the order of their pixels.
        rays: (pixels, 3) ray of each pixel, world axes, float32; ray times measurement is the
            offset of a point from its sensor.
        still: (pixels,) measurements of the empty site (m, 0 for no return).
        first: (sensors + 1,) number of the first pixel of each sensor, then the number of all."""

    def __init__(self, renderer: Renderer, sensors: Sequence[Sensor]) -> None:
        """Measure the empty site with each sensor, and list the rays of all.

        Pixels of all sensors are in one row, sensor after sensor, each image row by row."""
        self.sensors = tuple(sensors)
        self._renderer = renderer
        images = renderer.looking(sensors).background
        # pixels of all sensors in one row: measurements of the empty site
        self.still = np.concatenate([image.ravel() for image in images])
        # number of each sensor's first pixel, and of all pixels
        self.first = np.cumsum([0, *(image.size for image in images)])
        # rotations by which row vectors are turned from sensor axes to world axes
        turns = [sensor.pose[:3, :3].T.astype(np.float32) for sensor in sensors]
        rays = (sensor.model.rays().reshape(-1, 3) for sensor in sensors)
        self.rays = np.concatenate(
            [sensor_rays @ turn for sensor_rays, turn in zip(rays, turns, strict=True)]
        )
        self._poses = np.array([sensor.pose for sensor in sensors])
        max_ranges = np.repeat(
            [sensor.model.max_range for sensor in sensors], np.diff(self.first)
        ).astype(np.float32)
        # largest measurement of each pixel that an object can still have
        self._reach = np.where(self.still > 0, self.still, max_ranges)
        self._columns = np.array([sensor.model.shape[1] for sensor in sensors])  # image widths
        models: dict[SensorModel, list[int]] = {}
        for number, sensor in enumerate(sensors):
            models.setdefault(sensor.model, []).append(number)
        # each model, with the indices of its sensors
        self._sensors_of_model = [(model, np.array(numbers)) for model, numbers in models.items()]

    def windows(self, bodies: Int64[np.ndarray, " n"], boxes: BoxRows) -> list[Windows]:
        """Rectangles of pixels around each body in its box, for all sensors.

        Args:
            bodies: Index of each body among the renderer's bodies.
            boxes: Box of each body (x, y, z, length, width, height, yaw; world frame)."""
        windows: list[Windows] = []
        rotations = self._poses[:, :3, :3]
        positions = self._poses[:, None, :3, 3]
        for first in range(0, len(boxes), BOXES_TOGETHER):
            block = slice(first, first + BOXES_TOGETHER)
            # corners in sensor axes, with the axes body, sensor, corner, xyz
            in_sensor = (
                self._renderer.outer_corners(bodies[block], boxes[block])[:, None] - positions
            ) @ rotations
            count = len(in_sensor)
            nearest_lengths = np.zeros((count, len(self.sensors)), np.float32)
            parts = []
            owners = []  # index in the block of each rectangle's body
            for model, same_model in self._sensors_of_model:
                # row: box * number of sensors of the model + sensor, which divmod takes apart below
                corners = in_sensor[:, same_model].reshape(-1, 8, 3)
                nearest_lengths[:, same_model] = nearest(model, corners).reshape(count, -1)
                rectangles = model.windows(corners)  # columns row, top, bottom, left, right
                owner, index = np.divmod(rectangles[:, 0], len(same_model))
                rectangles[:, 0] = same_model[index]
                parts.append(rectangles)
                owners.append(owner)
            owner = np.concatenate(owners)
            rows = np.concatenate(parts)
            order = np.argsort(owner, kind="stable")
            ends = np.searchsorted(owner[order], np.arange(1, count))
            windows += [
                Windows(*pair)
                for pair in zip(np.split(rows[order], ends), nearest_lengths, strict=True)
            ]
        return windows

    def silhouette(
        self, body: int, box: Float64[np.ndarray, "7"], windows: Windows | None = None
    ) -> Silhouette:
        """Pixels that meet a body in its box, with no other object on the site.

        Args:
            body: Index among the renderer's bodies.
            box: x, y, z, length, width, height (m), yaw (rad); world frame.
            windows: Windows of this box from `windows`, None to find them here."""
        if windows is None:
            (windows,) = self.windows(np.array([body]), box[None])
        pixels, sensors = self._list_pixels(windows)
        if not len(pixels):
            return Silhouette(
                pixels, sensors, depth=np.zeros(0, np.float32), points=np.zeros((0, 3), np.float32)
            )
        body_from_world = self._renderer.body_from_world(box)
        rotation = body_from_world[:3, :3]
        positions = self._poses[:, :3, 3]  # the sensors' (m, world frame)
        body_positions = ((positions - box[:3]) @ rotation.T).astype(np.float32)
        # lines in the body's frame: start, `NEAR` ahead of the sensor, and direction
        lines = np.empty((len(pixels), 6), np.float32)
        starts = lines[:, :3]
        directions = lines[:, 3:]
        np.matmul(self.rays.take(pixels, axis=0), rotation.T.astype(np.float32), out=directions)
        np.multiply(directions, np.float32(NEAR), out=starts)
        starts += body_positions.take(sensors, axis=0)
        # lengths as multiples of a ray are measurements, as rays end at a measurement of 1 m
        depth = self._renderer.cast_body(body, lines) + np.float32(NEAR)
        met_rows = np.flatnonzero(depth < self._reach.take(pixels))  # nearer than the static scene
        pixels = pixels[met_rows]
        sensors = sensors[met_rows]
        depth = depth[met_rows]
        points = self.rays.take(pixels, axis=0) * depth[:, None]
        points += positions.astype(np.float32).take(sensors, axis=0)
        return Silhouette(pixels, sensors, depth, points)

    def _list_pixels(self, windows: Windows) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the pixels whose rays may meet a box, and the index of each pixel's sensor.

        Rays that end at the static scene or their range before they can reach it are left out.

        windows: Rectangles of pixels around the box: rows top to bottom, columns left to right."""
        sensor, top, bottom, left, right = windows.rows.T
        has_one_window_each = len(set(sensor.tolist())) == len(sensor)
        height = bottom - top
        # one entry for each row of pixels of each window: sensor, row in its image, first pixel
        row_sensor = np.repeat(sensor, height)
        # `counting`: 0, 1, 2 ... below the height of each window, one after the other
        row = counting(height) + np.repeat(top, height)
        first_pixel = self.first[row_sensor]  # first one in the sensor's image
        image_width = self._columns[row_sensor]
        begin = first_pixel + row * image_width + np.repeat(left, height)
        row_width = np.repeat(right - left, height)
        # one entry for each pixel
        pixels = counting(row_width) + np.repeat(begin, row_width)
        sensors = np.repeat(row_sensor, row_width)
        # a ray's end must be beyond the smallest measurement that the box can have
        in_reach = np.flatnonzero(self._reach.take(pixels) > windows.least.take(sensors))
        pixels = pixels[in_reach]
        sensors = sensors[in_reach]
        # a box across the seam of a lidar's image has a window at either end of the columns; the
        # two may overlap, and no pixel is to come twice
        if not has_one_window_each:
            pixels, first_places = np.unique(pixels, return_index=True)
            sensors = sensors[first_places]
        return pixels, sensors


class SeenPoints(NamedTuple):
    """Points of sensors on the scored objects of all frames, and in each frame.

    Attributes:
        points: Points without noise on each object, objects frame after frame.
        sent: Points expected in the crop under noise.
        far: The ones beyond the site's hybrid radius."""

    points: Float32[np.ndarray, "sensors objects"]
    sent: Float32[np.ndarray, "sensors frames"]
    far: Float32[np.ndarray, "sensors frames"]


class _Part(NamedTuple):
    """Pixels of one silhouette, and what each adds to the points of its sensor.

    Attributes:
        pixels: Numbers among the pixels of all sensors.
        sensors: Index of each pixel's sensor.
        depth: Measurement of the object (m).
        counted: True for pixels whose point is in the crop.
        sent: Points sent more than at the empty site, < 0 if the object hides one.
        far: Far points more than at the empty site, < 0 if the object hides one."""

    pixels: Int64[np.ndarray, " n"]
    sensors: Int64[np.ndarray, " n"]
    depth: Float32[np.ndarray, " n"]
    counted: Mask
    sent: Float32[np.ndarray, " n"]
    far: Float32[np.ndarray, " n"]


def look_at(
    traffic: Traffic,
    renderer: Renderer,
    sensors: Sequence[Sensor],
    labels: Sequence[int] = (VEHICLE,),
) -> SeenPoints:
    """Points of each sensor on the scored objects, and in the crop, for all frames.

    Args:
        traffic: Frames to look at.
        renderer: Renderer of the traffic's site and bodies; its sensors do not matter.
        sensors: Sensors in the order of the result's rows.
        labels: Classes (numbers) of the scored objects."""
    scene = _Scene(traffic.site, renderer, sensors)
    frames = []
    for snapshot in traffic.snapshots:
        placed = zip(snapshot.bodies.tolist(), snapshot.objects.boxes, strict=True)
        frames.append([((body, box.tobytes()), body, box) for body, box in placed])
    # bodies in their boxes in all frames, each once
    distinct_bodies = {key: (body, box) for frame in frames for key, body, box in frame}
    bodies = np.array([body for body, _ in distinct_bodies.values()], np.int64)
    boxes = np.array([box for _, box in distinct_bodies.values()]).reshape(-1, 7)
    # a vehicle that does not move has the same key in each frame, so its windows are found once
    windows = dict(zip(distinct_bodies, scene.views.windows(bodies, boxes), strict=True))
    points = [np.zeros((len(sensors), 0))]
    sent = []
    far = []
    parts: dict[tuple[int, bytes], _Part] = {}
    for snapshot, frame in zip(traffic.snapshots, frames, strict=True):
        # only parts of the frame before are reused; older ones are dropped to spare memory
        parts = {
            key: parts[key] if key in parts else scene.part(body, box, windows[key])
            for key, body, box in frame
        }
        on_objects, more_sent, more_far = scene.compose([parts[key] for key, _, _ in frame])
        points.append(on_objects[:, scored(snapshot.objects, traffic.site, labels)])
        sent.append(scene.sent + more_sent)
        far.append(scene.far + more_far)
    return SeenPoints(
        np.concatenate(points, axis=1).astype(np.float32),
        np.column_stack(sent).astype(np.float32),
        np.column_stack(far).astype(np.float32),
    )


class _Scene:
    """Sensors at the empty site, to which the objects of a frame are added.

    Attributes:
        views: Rays of the sensors.
        sent: (sensors,) points of each sensor sent at the empty site.
        far: (sensors,) the ones beyond the site's hybrid radius."""

    def __init__(self, site: Site, renderer: Renderer, sensors: Sequence[Sensor]) -> None:
        """Measure the empty site, and the expected number of its points that each sensor sends.

        sensors: those whose images are composed, in the order of all arrays by sensor."""
        self._site = site
        self._crop = Crop.from_place(site)
        views = self.views = SensorRays(renderer, sensors)
        self._positions = np.array([sensor.position for sensor in sensors], np.float32)
        models = [sensor.model for sensor in sensors]
        self._models = tuple(dict.fromkeys(models))
        self._model_of_sensor = np.array([self._models.index(model) for model in models])
        # index of each pixel's sensor; `views.first` has the number of each sensor's first pixel
        owner_of_pixel = np.repeat(np.arange(len(sensors)), np.diff(views.first))
        # chances of each pixel's point at the empty site, to be sent, and sent and far
        self._still_sent, self._still_far = np.zeros((2, len(views.still)), np.float32)
        # one image (slice of pixels) at a time, to spare memory
        for s, image in enumerate(map(slice, views.first[:-1], views.first[1:])):
            pixels = np.flatnonzero(views.still[image] > 0) + views.first[s]
            points = views.rays[pixels] * views.still[pixels, None] + self._positions[s]
            self._still_sent[pixels], self._still_far[pixels] = self._find_chances(
                points, views.rays[pixels], views.still[pixels], owner_of_pixel[pixels]
            )
        # expected points of each sensor at the empty site
        self.sent, self.far = (
            np.bincount(owner_of_pixel, weights=chances, minlength=len(sensors))
            for chances in (self._still_sent, self._still_far)
        )
        # scratch arrays of `compose`, one entry per pixel: nearest measurement, and who has it
        self._front = np.full(len(views.still), np.inf, np.float32)
        self._owner = np.zeros(len(views.still), np.int32)

    def part(self, body: int, box: np.ndarray, windows: Windows) -> _Part:
        """Pixels of a body in its box, as if no other object were there, and what they add.

        Args:
            body: Index among the renderer's bodies.
            box: x, y, z, length, width, height (m), yaw (rad); world frame.
            windows: Windows of this box."""
        pixels, sensors, depth, points = self.views.silhouette(body, box, windows)
        if not len(pixels):
            nothing = depth  # an empty array
            return _Part(pixels, sensors, depth, np.zeros(0, np.bool_), sent=nothing, far=nothing)
        rays = self.views.rays.take(pixels, axis=0)
        sent, far = self._find_chances(points, rays, depth, sensors)
        return _Part(
            pixels,
            sensors,
            depth,
            counted=self._crop.holds(points),
            sent=sent - self._still_sent.take(pixels),
            far=far - self._still_far.take(pixels),
        )

    def compose(self, parts: Sequence[_Part]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points of sensors on the n objects of a frame, and what they add to those sent and far.

        The nearest hit of a pixel counts; of equally near ones the first object's.

        Args:
            parts: Part of each object.

        Returns:
            (sensors, n) points in the crop on each object; (sensors,) points sent more than at the
            empty site; (sensors,) far points more than at the empty site."""
        count = len(self._positions)
        if not parts:
            return np.zeros((count, 0)), np.zeros(count), np.zeros(count)
        # all parts joined: one entry for each pixel of each object
        pixels, sensors, depth, counted, sent, far = (
            np.concatenate(columns) for columns in zip(*parts, strict=True)
        )
        objects = np.repeat(np.arange(len(parts)), [len(part.pixels) for part in parts])
        np.minimum.at(self._front, pixels, depth)
        nearest_hits = np.flatnonzero(depth == self._front.take(pixels))
        self._front[pixels] = np.inf  # ready for the next frame
        # assigned in reverse: of equally near hits of a pixel the first object's is written last
        self._owner[pixels[nearest_hits[::-1]]] = nearest_hits[::-1]
        hits = nearest_hits[self._owner.take(pixels[nearest_hits]) == nearest_hits]
        # flat index in the array (sensor, object) of each hit in the crop; `counted`: in the crop
        cells = (sensors * len(parts) + objects)[hits[counted[hits]]]
        on_objects = np.bincount(cells, minlength=count * len(parts)).reshape(count, len(parts))
        more_sent, more_far = (
            # chances already lack what the pixel sends at the empty site
            np.bincount(sensors[hits], weights=chances[hits], minlength=count)
            for chances in (sent, far)
        )
        return on_objects, more_sent, more_far

    def _find_chances(
        self, points: np.ndarray, rays: np.ndarray, depth: np.ndarray, sensors: np.ndarray
    ) -> Chances:
        """Chance of each of n points to be sent, and to be sent and far from its sensor.

        Args:
            points: (n, 3) points without noise (m, world frame).
            rays: (n, 3) rays of their pixels, world axes.
            depth: (n,) measurements (m), whose noise may lift a point out of the crop.
            sensors: (n,) index of each point's sensor."""
        deviation: np.ndarray | np.float32 = self._models[0].deviation(depth)
        if len(self._models) > 1:
            model_of_point = self._model_of_sensor.take(sensors)
            deviation = np.empty(len(depth), np.float32)
            for k in np.flatnonzero(np.bincount(model_of_point)):
                of_model = model_of_point == k
                deviation[of_model] = self._models[k].deviation(depth[of_model])
        spread = np.abs(rays[:, 2]) * deviation  # standard deviation of the height (m)
        positions = self._positions[:, :2].take(sensors, axis=0)
        return find_chances(points, spread, positions, self._site)


def find_chances(
    points: Float32[np.ndarray, "n 3"],
    spread: Float32[np.ndarray, " n"],
    positions: Float32[np.ndarray, "n 2"],
    site: Site,
) -> Chances:
    """Chance of each measured point to be sent, and to be sent and far.

    A point is sent if it is in the site's area, below the crop's height without noise, and above
    the ground with noise. It is far beyond the site's hybrid radius from its sensor.

    Args:
        points: Points without noise (m, world frame).
        spread: Standard deviation of each point's height (m).
        positions: x and y of each point's sensor (m, world frame).
        site: Site with the area, height, slope and hybrid radius."""
    levelled = level_rows(points, site.relief.slope)  # z above the ground
    is_in_crop = is_inside(levelled, site.area, site.height, -np.inf)
    z = levelled[:, 2]
    # height in deviations; beyond 8 the chance is 0 or 1 in float32
    x = np.clip(z / np.maximum(spread, np.float32(1e-6)), -8, 8)
    # the standard normal distribution function, within 0.0003 (Page 1977, J. Royal Stat. Soc. C 26)
    above_ground = 0.5 * (
        1 + np.tanh(np.float32(0.7978846) * x * (1 + np.float32(0.044715) * x * x))
    )
    sent = is_in_crop * above_ground
    offset = points[:, :2] - positions
    is_far = np.einsum("ij,ij->i", offset, offset) > site.hybrid_radius**2
    return Chances(sent=sent, far=sent * is_far)
