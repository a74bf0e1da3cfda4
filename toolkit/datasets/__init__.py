"""Recordings: the published layout, simulated ones, other people's files."""
