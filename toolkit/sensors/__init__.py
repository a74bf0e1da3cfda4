"""Sensor models, a file each, behind the `SensorModel` protocol, and sensors: a model at a pose."""
