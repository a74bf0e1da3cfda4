from .bodies.body import Body as Body
from .bodies.fleet import catalogue as catalogue
from .calibration.empty_scene import EmptyScene as EmptyScene, SceneLearner as SceneLearner
from .calibration.recording_scenes import Scenes as Scenes
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
from .datasets.recording_views import ReadRecording as ReadRecording, Reads as Reads
from .datasets.recordings import (
    open_recording as open_recording,
    write_recording as write_recording,
)
from .datasets.simulation import simulate_dataset as simulate_dataset
from .detection.background import (
    KnownBackground as KnownBackground,
    site_background as site_background,
)
from .detection.cluster import ClusterDetector as ClusterDetector
from .detection.codec import Codec as Codec
from .detection.messages import RangeImage as RangeImage
from .detection.paper_codec import PaperCodec as PaperCodec
from .detection.comparison import Comparison as Comparison
from .detection.evaluation import evaluate_recording as evaluate_recording
from .detection.evaluation_tables import format_table as format_table
from .detection.link.foreground import (
    Foreground as Foreground,
    decode_foreground as decode_foreground,
    encode_foreground as encode_foreground,
)
from .detection.link.sensor_codec import SensorCodec as SensorCodec
from .exchange.geo_origin import GeoOrigin as GeoOrigin
from .exchange.instant import Instant as Instant
from .exchange.standards import open_writer as open_writer
from .doctor.diagnosis import diagnose as diagnose
from .detection.metrics import (
    average_precision as average_precision,
    evaluate as evaluate,
    precision_recall as precision_recall,
)
from .detection.view import Fused as Fused
from .detection.scheme import Scheme as Scheme
from .detection.schemes import find_scheme as find_scheme, fuse_frame as fuse_frame
from .detection.survey import survey as survey
from .detection.view import View as View, suppress as suppress
from .frame import Frame as Frame, empty_scene as empty_scene, select_sensors as select_sensors
from .geometry import look as look, pose as pose
from .objects import Detections as Detections, Detector as Detector, Objects as Objects
from .plots.curves import draw_density_cdf as draw_density_cdf
from .points import frame_points as frame_points
from .rendering.renderer import Renderer as Renderer
from .runtime.run import Run as Run
from .sensors.error_profile import ErrorProfile as ErrorProfile
from .sensors.error_profiles import find_profile as find_profile
from .sensors.models import DepthCamera as DepthCamera, SpinningLidar as SpinningLidar
from .sensors.sensor import Sensor as Sensor, SensorModel as SensorModel
from .sites.files import load_site as load_site, save_site as save_site
from .sites.network import (
    build_network as build_network,
    road_polygons as road_polygons,
    street as street,
)
from .sites.random import random_site as random_site
from .sites.site import Mount as Mount, Relief as Relief, Site as Site, Solid as Solid
from .traffic.snapshots import Snapshot as Snapshot, simulate as simulate
