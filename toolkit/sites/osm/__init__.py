"""OpenStreetMap: what an extract holds, its roads for netconvert, and the solids beside them."""
