"""VoxelNet: voxels, network and anchors. The same network is also computed sparsely."""
