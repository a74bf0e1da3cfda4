"""Views of sensors, looked up in panoramas.

There is one panorama for each place and frame, for all sensors there in any direction.
"""
