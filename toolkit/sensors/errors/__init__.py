"""Errors of real sensors: terms that change what was measured, or where a sensor is believed to be, and profiles."""
