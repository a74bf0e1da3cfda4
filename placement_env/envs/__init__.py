"""Gymnasium environments, scalar and vector."""
