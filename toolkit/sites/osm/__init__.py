"""OpenStreetMap extracts: roads for netconvert, and solids next to them."""
