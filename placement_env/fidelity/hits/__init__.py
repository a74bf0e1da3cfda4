"""Probability that a detector hits an object with given points on it: the model, its fit, and what it was fitted to."""
