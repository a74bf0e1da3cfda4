from .config import VoxelNetConfig as VoxelNetConfig
from .detector import VoxelNetDetector as VoxelNetDetector, load_detector as load_detector
from .network.sparse import SparseVoxelNet as SparseVoxelNet
from .network.voxelnet import Prediction as Prediction, VoxelNet as VoxelNet
from .network.voxels import Voxels as Voxels, collate as collate, voxelise as voxelise
from .published import PublishedDetector as PublishedDetector, load_published as load_published
from .training.packing import pack as pack
from .weight_files import Header as Header, load_weights as load_weights, save_weights as save_weights
