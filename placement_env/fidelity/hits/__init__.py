"""Probability that a detector hits an object.

It depends on the points on the object. The package has the model, its fit, and the domain of the fit.
"""
