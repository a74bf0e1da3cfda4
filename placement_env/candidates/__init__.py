"""Sensors that may be built."""
