"""Traffic: SUMO, what it spawns and parks, and the snapshots that come of it."""
