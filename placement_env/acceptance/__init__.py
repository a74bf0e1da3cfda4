"""Comparison of a built street with its plan."""
