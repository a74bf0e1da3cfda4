"""VoxelNet: voxels, network, anchors, and sparse inference."""
