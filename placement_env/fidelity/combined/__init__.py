"""Fidelities made of fidelities: the mean over IoU thresholds, and what is left when sensors fail."""
