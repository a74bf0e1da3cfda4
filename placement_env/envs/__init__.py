"""The Gymnasium environments, scalar and vector."""
