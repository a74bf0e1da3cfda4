"""Points in files: PCD and PLY, with named columns as a cloud's attributes."""
