"""Bodies of moving objects: a catalogue, drawn ones, and users' meshes."""
