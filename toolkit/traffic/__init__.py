"""Traffic: SUMO, the spawner, parked vehicles, and snapshots of all of them."""
