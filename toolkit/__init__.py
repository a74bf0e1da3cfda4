"""What is there: sites, traffic, sensors, clouds, fusion and metrics. Nothing heavy loads until it is used."""

from typing import TYPE_CHECKING

from toolkit.runtime.lazy import lazily

# isort: off
if TYPE_CHECKING:
    from toolkit.bodies.body import Body as Body
    from toolkit.bodies.fleet import Fleet as Fleet, catalogue as catalogue, fleet_named as fleet_named
    from toolkit.bodies.meshes import load_meshes as load_meshes
    from toolkit.calibration.ground import Ground as Ground, level as level, level_warning as level_warning
    from toolkit.calibration.adaptation import SceneAdaptation as SceneAdaptation
    from toolkit.calibration.empty_scene import (
        EmptyScene as EmptyScene,
        SceneLearner as SceneLearner,
        learn_empty_scenes as learn_empty_scenes,
        load_empty_scenes as load_empty_scenes,
        save_empty_scenes as save_empty_scenes,
    )
    from toolkit.calibration.poses import find_sample_poses as find_sample_poses
    from toolkit.calibration.scenes import (
        SampleScenes as SampleScenes,
        learn_sample_scenes as learn_sample_scenes,
    )
    from toolkit.clouds import (
        crop as crop,
        down_sample as down_sample,
        from_depth as from_depth,
        fuse as fuse,
        points_per_box as points_per_box,
        sensor_numbers as sensor_numbers,
    )
    from toolkit.datasets.cloud_files import fuse_files as fuse_files
    from toolkit.datasets.dataset import CoopDataset as CoopDataset
    from toolkit.datasets.readings import read_frame as read_frame, with_errors as with_errors
    from toolkit.datasets.doctor import diagnose as diagnose
    from toolkit.datasets.simulation import simulate_dataset as simulate_dataset
    from toolkit.detection.background import KnownBackground as KnownBackground
    from toolkit.detection.cluster import ClusterDetector as ClusterDetector
    from toolkit.detection.codec import Codec as Codec, PaperCodec as PaperCodec, RangeImage as RangeImage
    from toolkit.detection.evaluation import (
        evaluate_dataset as evaluate_dataset,
        format_table as format_table,
        save_evaluation as save_evaluation,
    )
    from toolkit.detection.link.channel import LinkChannel as LinkChannel, lagged_frames as lagged_frames
    from toolkit.detection.link.differences import (
        DifferenceReader as DifferenceReader,
        DifferenceSender as DifferenceSender,
        ForegroundDifferences as ForegroundDifferences,
        MissedReference as MissedReference,
    )
    from toolkit.detection.link.foreground import (
        Foreground as Foreground,
        decode_foreground as decode_foreground,
        encode_foreground as encode_foreground,
    )
    from toolkit.detection.link.load import link_load as link_load
    from toolkit.detection.link.message import Inbox as Inbox
    from toolkit.detection.sensor_monitor import (
        Fault as Fault,
        SensorMonitor as SensorMonitor,
        Shown as Shown,
        standing_before as standing_before,
    )
    from toolkit.detection.link.range_images import RangeImages as RangeImages, codec_named as codec_named
    from toolkit.detection.link.tracks import Tracks as Tracks
    from toolkit.detection.metrics import (
        average_precision as average_precision,
        evaluate as evaluate,
        precision_recall as precision_recall,
    )
    from toolkit.detection.foreground_clusters import (
        foreground_clusters as foreground_clusters,
        learn_cluster_detector as learn_cluster_detector,
    )
    from toolkit.detection.scheme import Scheme as Scheme
    from toolkit.detection.schemes import Hybrid as Hybrid, fuse_frame as fuse_frame, scheme_of as scheme_of
    from toolkit.detection.site_background import (
        recording_background as recording_background,
        site_background as site_background,
    )
    from toolkit.detection.survey import survey as survey
    from toolkit.frame import Frame as Frame, empty_scene as empty_scene
    from toolkit.geometry import look as look, pose as pose
    from toolkit.objects import Detections as Detections, Detector as Detector, Objects as Objects
    from toolkit.plots.curves import (
        draw_density_cdf as draw_density_cdf,
        draw_pr_curves as draw_pr_curves,
        draw_training as draw_training,
    )
    from toolkit.plots.palette import sensor_colour as sensor_colour
    from toolkit.plots.plan_view import (
        FrameOutcome as FrameOutcome,
        draw_frame as draw_frame,
        draw_site as draw_site,
    )
    from toolkit.points import frame_points as frame_points, select_sensors as select_sensors
    from toolkit.rendering.renderer import Renderer as Renderer
    from toolkit.sensors.catalogue import model_named as model_named, register_sensor_model as register_sensor_model
    from toolkit.sensors.depth_camera import DepthCamera as DepthCamera
    from toolkit.sensors.errors.profile import ErrorProfile as ErrorProfile
    from toolkit.sensors.errors.profiles import profile_named as profile_named
    from toolkit.sensors.model import SensorModel as SensorModel
    from toolkit.sensors.row_lidar import RowLidar as RowLidar
    from toolkit.sensors.sensor import Sensor as Sensor
    from toolkit.sensors.solid_state_lidar import SolidStateLidar as SolidStateLidar
    from toolkit.sensors.spinning_lidar import SpinningLidar as SpinningLidar
    from toolkit.sites.files import load_site as load_site, save_site as save_site
    from toolkit.sites.maps import import_opendrive as import_opendrive, import_osm as import_osm
    from toolkit.sites.network import build_network as build_network, road_polygons as road_polygons, street as street
    from toolkit.sites.random import random_site as random_site
    from toolkit.sites.site import Mount as Mount, Relief as Relief, Site as Site, Solid as Solid
    from toolkit.traffic.snapshots import Snapshot as Snapshot, simulate as simulate
else:
    __getattr__, __dir__, __all__ = lazily(
        __name__,
        {
            "bodies.body": ("Body",),
            "bodies.fleet": ("Fleet", "catalogue", "fleet_named"),
            "bodies.meshes": ("load_meshes",),
            "calibration.ground": ("Ground", "level", "level_warning"),
            "calibration.adaptation": ("SceneAdaptation",),
            "calibration.empty_scene": (
                "EmptyScene",
                "SceneLearner",
                "learn_empty_scenes",
                "load_empty_scenes",
                "save_empty_scenes",
            ),
            "calibration.poses": ("find_sample_poses",),
            "calibration.scenes": ("SampleScenes", "learn_sample_scenes"),
            "clouds": ("crop", "down_sample", "from_depth", "fuse", "points_per_box", "sensor_numbers"),
            "datasets.cloud_files": ("fuse_files",),
            "datasets.dataset": ("CoopDataset",),
            "datasets.readings": ("read_frame", "with_errors"),
            "datasets.doctor": ("diagnose",),
            "datasets.simulation": ("simulate_dataset",),
            "detection.background": ("KnownBackground",),
            "detection.cluster": ("ClusterDetector",),
            "detection.codec": ("Codec", "PaperCodec", "RangeImage"),
            "detection.evaluation": ("evaluate_dataset", "format_table", "save_evaluation"),
            "detection.link.channel": ("LinkChannel", "lagged_frames"),
            "detection.link.differences": (
                "DifferenceReader",
                "DifferenceSender",
                "ForegroundDifferences",
                "MissedReference",
            ),
            "detection.link.foreground": ("Foreground", "decode_foreground", "encode_foreground"),
            "detection.link.load": ("link_load",),
            "detection.link.message": ("Inbox",),
            "detection.sensor_monitor": ("Fault", "SensorMonitor", "Shown", "standing_before"),
            "detection.link.range_images": ("RangeImages", "codec_named"),
            "detection.link.tracks": ("Tracks",),
            "detection.metrics": ("average_precision", "evaluate", "precision_recall"),
            "detection.foreground_clusters": ("foreground_clusters", "learn_cluster_detector"),
            "detection.scheme": ("Scheme",),
            "detection.schemes": ("Hybrid", "fuse_frame", "scheme_of"),
            "detection.site_background": ("recording_background", "site_background"),
            "detection.survey": ("survey",),
            "frame": ("Frame", "empty_scene"),
            "geometry": ("look", "pose"),
            "objects": ("Detections", "Detector", "Objects"),
            "plots.curves": ("draw_density_cdf", "draw_pr_curves", "draw_training"),
            "plots.palette": ("sensor_colour",),
            "plots.plan_view": ("FrameOutcome", "draw_frame", "draw_site"),
            "points": ("frame_points", "select_sensors"),
            "rendering.renderer": ("Renderer",),
            "sensors.catalogue": ("model_named", "register_sensor_model"),
            "sensors.depth_camera": ("DepthCamera",),
            "sensors.errors.profile": ("ErrorProfile",),
            "sensors.errors.profiles": ("profile_named",),
            "sensors.model": ("SensorModel",),
            "sensors.row_lidar": ("RowLidar",),
            "sensors.sensor": ("Sensor",),
            "sensors.solid_state_lidar": ("SolidStateLidar",),
            "sensors.spinning_lidar": ("SpinningLidar",),
            "sites.files": ("load_site", "save_site"),
            "sites.maps": ("import_opendrive", "import_osm"),
            "sites.network": ("build_network", "road_polygons", "street"),
            "sites.random": ("random_site",),
            "sites.site": ("Mount", "Relief", "Site", "Solid"),
            "traffic.snapshots": ("Snapshot", "simulate"),
        },
    )
