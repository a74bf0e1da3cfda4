"""VoxelNet: voxels, network, anchors, and the same network computed sparsely."""
