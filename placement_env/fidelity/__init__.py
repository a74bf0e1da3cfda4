"""Fidelities: ways to score sensor sets. They range from counting points to running the detector."""
