"""Views of sensors, looked up in panoramas, one for each place and frame and all sensors there."""
