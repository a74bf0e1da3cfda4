"""Calibration: each sensor's empty scene, ground and true pose."""
