"""Junctions prepared by the hundred, and the environment that shows an agent their maps alone."""
