"""What a sensor knows of the place it stands at: its empty scene, and where it really is."""
