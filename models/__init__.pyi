from .config import VoxelNetConfig as VoxelNetConfig
from .detector import VoxelNetDetector as VoxelNetDetector
from .detector_loading import load_detector as load_detector
from .published import load_published as load_published
from .weight_files import load_weights as load_weights
