"""Views of sensors, looked up in panoramas: one for each place and frame, for all that hangs there however it looks."""
