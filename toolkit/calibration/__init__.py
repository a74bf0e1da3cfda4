"""Calibration: where the ground lies below a cloud, and where a sensor really hangs."""
