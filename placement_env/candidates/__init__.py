"""Candidates: the sensors that may be built, from pools of poses and poles of a city."""
