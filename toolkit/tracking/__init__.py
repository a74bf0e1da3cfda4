"""Tracking: road users over time, from the detections of frames."""
