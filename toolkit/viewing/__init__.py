"""Recordings looked at in three dimensions: scenes of viser, live in the browser or as one page."""
