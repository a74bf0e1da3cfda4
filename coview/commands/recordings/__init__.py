"""Commands about sites and recordings: what is there, and what sensors measured of it."""
