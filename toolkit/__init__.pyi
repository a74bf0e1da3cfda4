from .bodies.body import Body as Body
from .bodies.fleet import Fleet as Fleet, catalogue as catalogue, fleet_named as fleet_named
from .bodies.meshes import load_meshes as load_meshes
from .calibration.adaptation import SceneAdaptation as SceneAdaptation
from .calibration.empty_scene import (
    EmptyScene as EmptyScene,
    SceneLearner as SceneLearner,
    learn_empty_scenes as learn_empty_scenes,
    load_empty_scenes as load_empty_scenes,
    save_empty_scenes as save_empty_scenes,
)
from .calibration.ground import Ground as Ground, level as level, level_warning as level_warning
from .calibration.poses import find_sample_poses as find_sample_poses
from .calibration.scenes import SampleScenes as SampleScenes, learn_sample_scenes as learn_sample_scenes
from .clouds import (
    crop as crop,
    down_sample as down_sample,
    from_depth as from_depth,
    fuse as fuse,
    points_per_box as points_per_box,
    sensor_numbers as sensor_numbers,
)
from .datasets.cloud_files import fuse_files as fuse_files
from .datasets.dataset import CoopDataset as CoopDataset
from .datasets.doctor import diagnose as diagnose
from .datasets.readings import read_frame as read_frame, with_errors as with_errors
from .datasets.simulation import simulate_dataset as simulate_dataset
from .detection.background import KnownBackground as KnownBackground
from .detection.cluster import ClusterDetector as ClusterDetector
from .detection.codec import Codec as Codec, PaperCodec as PaperCodec, RangeImage as RangeImage
from .detection.evaluation import (
    evaluate_dataset as evaluate_dataset,
    format_table as format_table,
    save_evaluation as save_evaluation,
)
from .detection.foreground_clusters import (
    foreground_clusters as foreground_clusters,
    learn_cluster_detector as learn_cluster_detector,
)
from .detection.link.channel import LinkChannel as LinkChannel, lagged_frames as lagged_frames
from .detection.link.differences import (
    DifferenceReader as DifferenceReader,
    DifferenceSender as DifferenceSender,
    ForegroundDifferences as ForegroundDifferences,
    MissedReference as MissedReference,
)
from .detection.link.foreground import (
    Foreground as Foreground,
    decode_foreground as decode_foreground,
    encode_foreground as encode_foreground,
)
from .detection.link.load import link_load as link_load
from .detection.link.message import Inbox as Inbox
from .detection.link.range_images import RangeImages as RangeImages, codec_named as codec_named
from .detection.link.tracks import Tracks as Tracks
from .detection.metrics import (
    average_precision as average_precision,
    evaluate as evaluate,
    precision_recall as precision_recall,
)
from .detection.scheme import Scheme as Scheme
from .detection.schemes import Hybrid as Hybrid, fuse_frame as fuse_frame, scheme_of as scheme_of
from .detection.sensor_monitor import (
    Fault as Fault,
    SensorMonitor as SensorMonitor,
    Shown as Shown,
    standing_before as standing_before,
)
from .detection.site_background import (
    recording_background as recording_background,
    site_background as site_background,
)
from .detection.survey import survey as survey
from .frame import Frame as Frame, empty_scene as empty_scene
from .geometry import look as look, pose as pose
from .objects import Detections as Detections, Detector as Detector, Objects as Objects
from .plots.curves import (
    draw_density_cdf as draw_density_cdf,
    draw_pr_curves as draw_pr_curves,
    draw_training as draw_training,
)
from .plots.palette import sensor_colour as sensor_colour
from .plots.plan_view import FrameOutcome as FrameOutcome, draw_frame as draw_frame, draw_site as draw_site
from .points import frame_points as frame_points, select_sensors as select_sensors
from .rendering.renderer import Renderer as Renderer
from .sensors.error_profiles import ErrorProfile as ErrorProfile, profile_named as profile_named
from .sensors.models import (
    DepthCamera as DepthCamera,
    RowLidar as RowLidar,
    SolidStateLidar as SolidStateLidar,
    SpinningLidar as SpinningLidar,
    model_named as model_named,
    register_sensor_model as register_sensor_model,
)
from .sensors.sensor import Sensor as Sensor, SensorModel as SensorModel
from .sites.files import load_site as load_site, save_site as save_site
from .sites.maps import import_opendrive as import_opendrive, import_osm as import_osm
from .sites.network import build_network as build_network, road_polygons as road_polygons, street as street
from .sites.random import random_site as random_site
from .sites.site import Mount as Mount, Relief as Relief, Site as Site, Solid as Solid
from .traffic.snapshots import Snapshot as Snapshot, simulate as simulate
