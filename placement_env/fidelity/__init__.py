"""Fidelities: how sensor sets are scored, from counting points to running the detector."""
