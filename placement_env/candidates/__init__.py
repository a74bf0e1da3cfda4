"""Sensors that may be built: pools of poses, the poles of a city, catalogues of models."""
