"""Calibration: what a sensor knows of the place it stands at: its empty scene, the ground, and where it really is."""
