"""Junctions: built-in, random and imported from maps."""

BUILT_IN = ("roundabout", "tjunction")
