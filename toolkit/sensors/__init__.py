"""Sensors: models, and errors of real ones."""
