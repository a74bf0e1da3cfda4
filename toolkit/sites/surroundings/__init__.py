"""Ground around a road, parking bays, sensor places, and drawn things next to the road."""
