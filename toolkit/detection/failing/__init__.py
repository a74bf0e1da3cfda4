"""Sensors that fail: how the fusion centre notices."""
