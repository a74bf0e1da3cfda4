"""Junctions: built-in, random and imported from maps. The built-in ones are `tjunction` and `roundabout`."""

BUILT_IN = ("roundabout", "tjunction")
