"""What is seen: VoxelNet, its training and its weights. Needs torch, numpy, h5py and shapely only."""
