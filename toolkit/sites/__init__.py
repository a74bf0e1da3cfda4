"""Junctions: two built in (`tjunction`, `roundabout`), random ones, and ones imported from maps."""

BUILT_IN = ("roundabout", "tjunction")
