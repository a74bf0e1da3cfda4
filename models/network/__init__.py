"""The network: voxels, VoxelNet, its anchors, and the same computed where the points reach."""
