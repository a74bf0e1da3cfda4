"""Traffic: SUMO, the spawner, parked vehicles, snapshots."""
