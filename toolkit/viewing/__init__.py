"""Viewing recordings in 3D with viser."""
