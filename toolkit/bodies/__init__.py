"""Bodies of what moves: cars, trucks, cyclists, pedestrians, and meshes of the user's."""
