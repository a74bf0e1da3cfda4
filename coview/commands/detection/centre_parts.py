"""Parts of a running centre, opened as its configuration asks for them."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from coview.detector_spec import DetectorSpec
from coview.detectors import check_detector
from coview.recordings import Opening

if TYPE_CHECKING:
    from toolkit.calibration.empty_scene import EmptyScene
    from toolkit.calibration.recording_scenes import LearntScene
    from toolkit.centre.centre_config import CentreConfig, InputConfig
    from toolkit.centre.centre_run import CentreParts
    from toolkit.centre.detection_pool import Detection
    from toolkit.centre.ouster_input import OusterInput
    from toolkit.centre.velodyne_input import VelodyneInput
    from toolkit.frame import Recording
    from toolkit.sites.site import Site

_INTERVAL_S = 0.1  # if neither input nor configuration states it
_LEARNT_IMAGES = 64  # from which a sensor's empty scene is learnt


@contextmanager
def open_centre(config: "CentreConfig") -> "Iterator[CentreParts]":
    """Open the inputs, the detector and the empty scenes of a centre for a block.

    Raises the errors of the readers, of `coview.detectors.open_detector` and of the writers."""
    spec = DetectorSpec.from_name(config.detector)
    check_detector(spec)
    config.output.make_writer()  # refuses wrong formats before long work
    with ExitStack() as stack:
        match config.inputs[0].kind:
            case "recording":
                recording = stack.enter_context(_open_recording(config.inputs[0]))
                parts = _replay(config, spec, recording)
            case "junction":
                parts = _simulate(config, spec)
            case "velodyne" | "ouster":
                parts = _listen(config, spec)
        parts = _configure(parts, config)
        stack.enter_context(_share_cores(parts.detection.parallel))
        yield parts


@contextmanager
def _share_cores(parallel: int) -> "Iterator[None]":
    """Give each of some parallel detections its share of the cores for a block.

    One core is left to the rest of the centre: a network whose threads wait for a core that others
    need is slower than with one thread less."""
    torch = sys.modules.get("torch")  # loaded by detectors that need it
    if torch is None:
        yield
        return
    threads = torch.get_num_threads()
    torch.set_num_threads(max(1, (threads - 1) // parallel))
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@contextmanager
def _open_recording(source: "InputConfig") -> "Iterator[Recording]":
    """Open the recording of an input for a block."""
    opening = Opening(layout=source.layout, poses=source.poses, site=source.site or None)
    with opening.open(source.path) as recording:
        yield recording


def _replay(config: "CentreConfig", spec: DetectorSpec, recording: "Recording") -> "CentreParts":
    """Return the parts of a centre that replays a recording.

    config: the centre's file, whose one input is the recording; spec: parsed name of the detector,
    which may learn the standing scene if the site is unknown."""
    from coview.commands.detection.placed_detectors import Detectors
    from toolkit.calibration.recording_scenes import Scenes
    from toolkit.centre.centre_run import CentreParts
    from toolkit.centre.detection_pool import Detection
    from toolkit.centre.recording_input import RecordingInput
    from toolkit.datasets.recording_views import ReadRecording, Reads
    from toolkit.detection.standing import learn_standing_scene

    frames = ReadRecording(recording, Reads(config.inputs[0].errors))
    source = RecordingInput(frames)
    is_known = config.place.uses_site(recording.site)
    learns_scene = recording.site is None and spec.learns_scene
    scene = learn_standing_scene(frames) if learns_scene else None
    (placed,) = Detectors(spec, config.place).choose([recording], [scene])
    return CentreParts(
        inputs=[source],
        detection=Detection(
            placed.detector, placed.place, site=recording.site if is_known else None, scene=scene
        ),
        interval_s=config.interval_s or source.interval_s,
        spread_s=source.spread_s,
        scenes=Scenes(frames, sample=_LEARNT_IMAGES).every,
        speed=config.speed,
        sample=frames[0],
    )


def _simulate(config: "CentreConfig", spec: DetectorSpec) -> "CentreParts":
    """Return the parts of a centre at a simulated junction.

    config: the centre's file, whose one input has site, duration (s) and seed; spec: parsed name of
    the detector."""
    from toolkit.calibration.empty_scene import EmptyScene
    from toolkit.centre.centre_run import CentreParts
    from toolkit.centre.junction_input import JunctionInput
    from toolkit.frame import Frame
    from toolkit.objects import Objects
    from toolkit.rendering.renderer import Renderer
    from toolkit.sites.files import load_site

    row = config.inputs[0]
    site = load_site(row.site)
    interval_s = config.interval_s or _INTERVAL_S
    source = JunctionInput(site, interval_s, row.seconds, row.seed)
    backgrounds = Renderer(site, (), site.sensors, threads=1).background
    scenes = [
        EmptyScene.from_render(sensor, image)
        for sensor, image in zip(site.sensors, backgrounds, strict=True)
    ]
    return CentreParts(
        [source],
        _detect_at_site(spec, site),
        interval_s,
        scenes=_wrap_scenes(scenes),
        speed=config.speed,
        sample=Frame(site.sensors, backgrounds, Objects.empty()),
    )


def _detect_at_site(spec: DetectorSpec, site: "Site") -> "Detection":
    """Return the detector of a known site."""
    from coview.detectors import open_detector
    from toolkit.centre.detection_pool import Detection

    return Detection(open_detector(spec.in_bfloat16(), site), site=site)


def _listen(config: "CentreConfig", spec: DetectorSpec) -> "CentreParts":
    """Return the parts of a centre of lidars that send packets.

    config: the centre's file, with an input for each lidar; spec: parsed name of the detector."""
    from coview.detectors import open_detector
    from toolkit.centre.centre_run import CentreParts
    from toolkit.centre.detection_pool import Detection

    place = replace(config.place, level=config.place.level or "map")
    return CentreParts(
        [_open_lidar(row, config) for row in config.inputs],
        detection=Detection(open_detector(spec.in_bfloat16(), place), place),
        interval_s=config.interval_s or _INTERVAL_S,
        spread_s=config.interval_s or _INTERVAL_S,  # lidars turn freely
    )


def _open_lidar(row: "InputConfig", config: "CentreConfig") -> "VelodyneInput | OusterInput":
    """Return a lidar on the network as an input, at the configuration's pose."""
    from toolkit.centre.ouster_input import OusterInput, load_ouster_metadata
    from toolkit.centre.packet_port import PacketPort
    from toolkit.centre.velodyne_input import VelodyneInput

    port = PacketPort(row.port, row.address)
    pose = config.setups[row.name].pose if row.name in config.setups else None
    if row.kind == "velodyne":
        return VelodyneInput(row.name, port, pose)
    assert row.metadata is not None  # an Ouster's configuration names it
    load_ouster_metadata(row.metadata)  # refuses wrong metadata before the run begins
    return OusterInput(row.name, port, pose, metadata=row.metadata)


def _configure(parts: "CentreParts", config: "CentreConfig") -> "CentreParts":
    """Return parts with the configuration's rate, files, poses, clocks and empty scenes."""
    from toolkit.calibration.scene_files import load_empty_scenes

    given_scenes = []
    for name, path in config.backgrounds.items():
        scenes = [scene for scene in load_empty_scenes(path) if scene.name == name]
        if not scenes:
            raise ValueError(f"{path} has no empty scene of {name!r}: learn it again")
        given_scenes += scenes
    return replace(
        parts,
        detection=replace(
            parts.detection,
            detect_every=config.detect_every,
            parallel=config.parallel,
            deadline_s=config.deadline_s,
        ),
        setups=config.setups,
        output=config.output,
        scenes={**parts.scenes, **_wrap_scenes(given_scenes)},
    )


def _wrap_scenes(scenes: "Sequence[EmptyScene]") -> "dict[str, LearntScene]":
    """Return given empty scenes by sensor."""
    from toolkit.calibration.recording_scenes import Scenes

    return Scenes((), given=scenes).every if scenes else {}
