"""Fidelities: ways to score sensor sets."""
