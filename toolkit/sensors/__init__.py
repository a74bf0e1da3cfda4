"""Sensors: models behind the `SensorModel` protocol, and errors of real ones."""
