"""Drawings in the live planner's scene that follow what is planned: sensors, suggestions, areas,
pictures, traffic and maps. Only what has changed is sent again."""

import secrets
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from coview.live_cameras import Spot
from coview.live_names import add_name
from coview.live_signs import lay_picture
from coview.live_tables import format_ap
from placement_env.live.picture import GroundPicture
from placement_env.live.planner import LivePlanner
from placement_env.live.seen_map import MAP_HEIGHTS, SeenMaps
from placement_env.live.suggestions import Suggestion
from placement_env.live.variant import LiveSensor
from toolkit.plots.palette import FAINT, INK, OUTCOME, sensor_colour
from toolkit.sensors.sensor import Sensor
from toolkit.viewing import scene, scene_parts
from toolkit.viewing.box_lines import arrows, roof_crosses
from toolkit.viewing.box_styles import BoxStyle, add_boxes
from toolkit.viewing.scene import Handle
from toolkit.viewing.sensor_parts import draw_view, find_target
from toolkit.viewing.site_scene import lift_points

if TYPE_CHECKING:
    from viser import SceneApi

    from placement_env.live.figures import LiveAnswer

MIN_FOUND_SHARE = 0.5  # hit probability from which a road user is drawn as found
# sizes along x, y and z (m) of the box that shows a sensor, and that shows a suggested one
HOUSING_SIZE_M = (1.2, 1.2, 0.9)
GHOST_SIZE_M = (1.1, 1.1, 0.9)
HANDLE_RADIUS_M = 0.8
# heights of labels: a sensor's above its handle, a suggestion's above its sensor
LABEL_RISE_M = 1.1
GHOST_LABEL_RISE_M = 2.2
TRAFFIC_WIDTH_PX = 2.5
FOUND_STYLE = BoxStyle(OUTCOME["hit"].colour, TRAFFIC_WIDTH_PX)
MISSED_STYLE = BoxStyle(OUTCOME["missed"].colour, TRAFFIC_WIDTH_PX, mark=roof_crosses)
GHOST_COLOUR = "#4463f6"
AREA_COLOUR = "#b3261e"
# heights of drawings above the ground
AREA_LIFT_M = 0.2
MAP_LIFT_M = 0.1
MAP_ALPHA = 190  # opacity of the map, 0 to 255
Attach = Callable[[str, Handle, Handle], None]  # called with a sensor's name, housing and handle


class SensorDrawings:
    """Drawings of the sensors: housing, handle, lines of its view, and label of each.

    Only sensors that have changed are sent to the browsers again."""

    def __init__(self, api: "SceneApi", planner: LivePlanner) -> None:
        """Keep the scene and the planner; nothing is drawn yet."""
        self._api = api
        self._planner = planner
        # by name of the sensor: housing, handle, view and label
        self._nodes: dict[str, list[Handle]] = {}
        # by name of the sensor: its index in the variant and its state as they were drawn last
        self._drawn_states: dict[str, tuple[int, LiveSensor]] = {}
        self._pole_labels: dict[str, Handle] = {}  # by name of the pole

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the sensors that are drawn."""
        return tuple(self._nodes)

    def label_poles(self, labels: dict[str, Handle]) -> None:
        """Take over the labels of the poles, by name of the pole.

        A pole's label is hidden while a sensor is on it, whose label shows the name."""
        self._pole_labels = labels

    def put_housing(self, name: str, spot: Spot) -> None:
        """Move the housing of a sensor to a spot (m), without a change of the variant.

        The next `draw` puts it back. A sensor that is not drawn is ignored."""
        if name in self._nodes:
            housing, *_ = self._nodes[name]
            housing.position = spot
            self._drawn_states.pop(name, None)

    def draw(self, attach: Attach) -> None:
        """Draw the sensors of the planner's variant, and remove drawings of others.

        Only a sensor that has changed is drawn again. attach: function that lets a new drawing be
        dragged."""
        variant = self._planner.variant
        mounts_in_use = {sensor.mount for sensor in variant.sensors}
        for pole, label in self._pole_labels.items():
            is_visible = pole not in mounts_in_use
            if label.visible != is_visible:  # an assignment sends a message to the browsers
                label.visible = is_visible
        shown_names = {sensor.name for sensor in variant.sensors}
        removed_names = [name for name in self._nodes if name not in shown_names]
        for name in removed_names:
            self._drawn_states.pop(name, None)
            for node in self._nodes.pop(name):
                node.remove()
        for index, live_sensor in enumerate(variant.sensors):
            name = live_sensor.name
            # all that the drawing shows; the index decides the colour
            state = index, live_sensor
            if name in self._nodes and self._drawn_states.get(name) == state:
                continue
            self._drawn_states[name] = state
            sensor = self._planner.yard.build_sensor(variant, live_sensor)
            colour = scene.rgb(FAINT if live_sensor.failed else sensor_colour(index))
            if name not in self._nodes:
                self._nodes[name] = self._add_sensor(name, sensor, colour, attach)
            self._update_sensor(live_sensor, sensor, colour)

    def _add_sensor(
        self, name: str, sensor: Sensor, colour: tuple[int, int, int], attach: Attach
    ) -> list[Handle]:
        """Add the drawing of a sensor to the scene; return its housing, handle, view and label.

        colour: red, green, blue, 0 to 255; attach: lets housing and handle be dragged."""
        site = self._planner.yard.site
        # names of nodes are random, independent of the sensors' names
        node = f"/planned/{secrets.token_hex(4)}"
        housing = self._api.add_box(f"{node}/housing", colour, HOUSING_SIZE_M)
        handle = self._api.add_icosphere(f"{node}/handle", HANDLE_RADIUS_M, colour, subdivisions=2)
        lines = draw_view(site, sensor, find_target(site, sensor))
        view = self._api.add_line_segments(
            f"{node}/view", lines, colour, thickness=2.5, thickness_units="screen"
        )
        label = add_name(
            self._api, node=f"{node}/label", name=name, position=sensor.position, scale=1.2
        )
        attach(name, housing, handle)
        return [housing, handle, view, label]

    def _update_sensor(
        self, live_sensor: LiveSensor, sensor: Sensor, colour: tuple[int, int, int]
    ) -> None:
        """Move and colour the drawing of a sensor as it is now.

        sensor: built from `live_sensor`; colour: red, green, blue, 0 to 255."""
        site = self._planner.yard.site
        housing, handle, view, label = self._nodes[live_sensor.name]
        target = find_target(site, sensor)
        housing.position = sensor.position
        handle.position = target
        housing.color = handle.color = colour
        view.points = draw_view(site, sensor, target)
        view.colors = np.array(colour, np.uint8)
        # at the handle: labels of two sensors on a pole are then apart
        label.position = target + np.array([0.0, 0.0, LABEL_RISE_M])
        text = live_sensor.name
        if live_sensor.failed:
            text += " (failed)"
        if live_sensor.locked:
            text += " (locked)"
        label.text = text


class Ghosts:
    """Suggestions, drawn as translucent sensors.

    accept: function that is called with a suggestion whose housing is clicked."""

    def __init__(
        self, api: "SceneApi", planner: LivePlanner, accept: Callable[[Suggestion], None]
    ) -> None:
        """Draw nothing yet. accept: called with a suggestion whose drawing is clicked."""
        self._api = api
        self._planner = planner
        self._accept = accept  # called with a suggestion that is clicked
        self._suggestions: list[Suggestion] = []  # to draw, the best first
        self._nodes: list[Handle] = []  # parts of all drawings

    def offer(self, suggestions: Sequence[Suggestion]) -> None:
        """Keep suggestions, the best first, to be drawn in place of earlier ones."""
        self._suggestions = list(suggestions)

    def take_best(self) -> Suggestion:
        """Return the best suggestion, and forget all. Raises ValueError if there is none."""
        if not self._suggestions:
            raise ValueError("nothing is suggested: ask for a suggestion first")
        best = self._suggestions[0]
        self._suggestions = []
        return best

    def draw(self) -> None:
        """Draw the kept suggestions, and remove earlier ones."""
        for node in self._nodes:
            node.remove()
        self._nodes = []
        for k, suggestion in enumerate(self._suggestions):
            self._nodes += self._add_ghost(k, suggestion)

    def _add_ghost(self, k: int, suggestion: Suggestion) -> list[Handle]:
        """Draw the k-th suggestion with the AP that it leads to; return housing, view and label."""
        yard = self._planner.yard
        sensor = yard.build_sensor(self._planner.variant, suggestion.sensor)
        node = f"/ghosts/{k}"
        colour = scene.rgb(GHOST_COLOUR)
        housing = self._api.add_box(
            f"{node}/housing", colour, GHOST_SIZE_M, opacity=0.4, position=sensor.position
        )
        housing.on_click(lambda _: self._accept(suggestion))
        lines = draw_view(yard.site, sensor, find_target(yard.site, sensor))
        view = self._api.add_line_segments(f"{node}/view", lines, colour)
        text = f"AP {format_ap(suggestion.answer)}"
        if suggestion.kind == "remove":
            text = f"without {text}"
        position = sensor.position + np.array([0.0, 0.0, GHOST_LABEL_RISE_M])
        label = scene_parts.add_label(self._api, f"{node}/label", text, position)
        return [housing, view, label]


class AreaDrawing:
    """Drawing of the variant's keep-out areas, and of the one that is being clicked."""

    def __init__(self, api: "SceneApi", planner: LivePlanner) -> None:
        self._api = api
        self._planner = planner
        # corners (x, y in m) of each area as they were drawn last
        self._drawn_outlines: list[tuple[tuple[float, float], ...]] | None = None

    def draw(self, spots: Sequence[Spot]) -> None:
        """Draw the outlines of all areas if one has changed.

        spots: corners x, y, z (m, site's frame) of a new area so far, whose outline stays open."""
        site = self._planner.yard.site
        lines = []  # start and end, as x, y and z (m)
        # corners x, y (m) of each area; the first one again at the end closes an outline
        outlines = [(*corners, corners[0]) for corners in self._planner.variant.keep_out]
        outlines.append(tuple((float(x), float(y)) for x, y, _ in spots))
        if self._drawn_outlines == outlines:
            return
        self._drawn_outlines = outlines
        for outline in outlines:
            points = lift_points(site, np.array(outline).reshape(-1, 2), AREA_LIFT_M)
            lines += [[start, end] for start, end in pairwise(points)]
        self._api.remove_by_name("/areas")
        segments = np.array(lines).reshape(-1, 2, 3)  # axes: line, end, xyz
        scene_parts.add_lines(self._api, "/areas", segments, AREA_COLOUR, width=4.0, visible=True)


class PictureDrawing:
    """Drawing of the picture under the scene. folder: folder of its file."""

    def __init__(self, api: "SceneApi", planner: LivePlanner, folder: Path) -> None:
        self._api = api
        self._planner = planner
        self._folder = folder
        self._drawn: GroundPicture | None = None

    def draw(self) -> None:
        """Draw the planner's picture if it has changed, or remove it if it is gone."""
        picture = self._planner.picture
        if self._drawn == picture:
            return
        self._drawn = picture
        self._api.remove_by_name("/picture")
        if picture is not None:
            lay_picture(self._api, self._planner.yard.site, picture, self._folder)


class TrafficDrawing:
    """Road users of one frame: found, missed, and seen by no sensor."""

    def __init__(self, api: "SceneApi", planner: LivePlanner) -> None:
        self._api = api
        self._planner = planner
        self._nodes: list[Handle] = []
        self._drawn: tuple[list[int], list[bool], list[bool]] | None = None

    def draw(self, answer: "LiveAnswer | None", frame: int) -> None:
        """Draw the road users of a frame as an answer finds them, if they have changed.

        answer: its probabilities decide between found and missed; None draws nothing."""
        road_users = self._planner.unseen  # in all frames
        if answer is None or len(answer.probability) != len(road_users.boxes):
            return  # the answer has fewer frames than the planner; one of all frames follows
        rows = np.flatnonzero(road_users.frame == frame)  # this frame's road users
        is_found = answer.probability[rows] >= MIN_FOUND_SHARE
        is_hidden = answer.hidden[rows]
        state = rows.tolist(), is_found.tolist(), is_hidden.tolist()
        if self._drawn == state:
            return
        self._drawn = state
        for node in self._nodes:
            node.remove()
        api = self._api
        found_boxes = road_users.boxes[rows[is_found]]
        missed_boxes = road_users.boxes[rows[~is_found]]
        # arrows above hidden road users, which are found or missed, too
        arrow_lines = arrows(road_users.boxes[rows[is_hidden]])
        nodes = (
            add_boxes(
                api, name="/traffic/found", boxes=found_boxes, style=FOUND_STYLE, visible=True
            ),
            add_boxes(
                api, name="/traffic/missed", boxes=missed_boxes, style=MISSED_STYLE, visible=True
            ),
            scene_parts.add_lines(
                api, "/traffic/unseen", arrow_lines, INK, width=TRAFFIC_WIDTH_PX, visible=True
            ),
        )
        self._nodes = [node for node in nodes if node is not None]


class SeenMapDrawing:
    """Drawing of how often each cell of the ground is seen, at the height of a road user."""

    def __init__(self, api: "SceneApi", planner: LivePlanner) -> None:
        self._api = api
        self._planner = planner
        self._maps: dict[float, SeenMaps] = {}  # by height (m)

    def forget(self) -> None:
        """Forget the maps in memory, as the traffic has other frames now."""
        self._maps.clear()

    def draw(self, kind: str) -> None:
        """Draw on the ground how often the working sensors see each place.

        kind: kind of road user among `MAP_HEIGHTS`, whose height must be seen. For any other text,
        such as "off", the map is removed."""
        self._api.remove_by_name("/seen")
        if kind not in MAP_HEIGHTS:
            return
        from matplotlib import colormaps

        height = MAP_HEIGHTS[kind]
        if height not in self._maps:
            self._maps[height] = SeenMaps(self._planner.preparation, height)
        working_sensors = [sensor for sensor in self._planner.sensors if not sensor.failed]
        variant = self._planner.variant
        yard = self._planner.yard
        seen_map = self._maps[height].draw(
            yard.build_sensor(variant, sensor) for sensor in working_sensors
        )
        # share of frames in which each cell is seen; NaN in buildings
        shares = np.nan_to_num(seen_map.share)
        pixels = (255 * np.asarray(colormaps["viridis_r"](shares))).astype(np.uint8)  # RGBA
        pixels[..., 3] = np.where(np.isnan(seen_map.share), 0, MAP_ALPHA)
        cell_m = float(seen_map.x[1] - seen_map.x[0])
        middle = np.array([seen_map.x.mean(), seen_map.y.mean()])
        position = (*middle.tolist(), float(yard.site.ground(middle)) + MAP_LIFT_M)
        self._api.add_image(
            "/seen",
            pixels,
            len(seen_map.x) * cell_m,  # width on the ground (m)
            len(seen_map.y) * cell_m,
            position=position,
            cast_shadow=False,
        )
