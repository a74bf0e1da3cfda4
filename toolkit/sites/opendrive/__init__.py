"""OpenDRIVE maps about a place: roads, lanes, objects and signals, as sites and for netconvert."""
