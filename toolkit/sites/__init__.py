"""Junctions: two built in (`tjunction`, `roundabout`), and the road networks all of them are made from."""

BUILT_IN = ("roundabout", "tjunction")
