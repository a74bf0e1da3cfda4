"""Sites from pieces of OpenDRIVE or OpenStreetMap files.

SUMO's netconvert makes their roads. The site frame is centred at the given place, x along
`heading`; `map_SE3_site` leads back to the map's coordinates. These are in the OpenDRIVE file's
projection, to which its header's offset leads, or metres of a transverse Mercator map of WGS84
(`geo_reference`) about the centre. The site has no sensors yet; mounts on lamp posts are real,
mounts along the kerbs are suggestions, all at a price of 1. Surroundings that the map leaves open
are drawn from a seed."""
