"""Stress tests of a deployed set of sensors. They measure how much of its AP is left."""
