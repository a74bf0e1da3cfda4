"""OpenDRIVE maps: reference lines, surfaces of lanes, objects and signals."""
