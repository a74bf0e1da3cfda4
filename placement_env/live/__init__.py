"""Live planning: a set of sensors that is moved by hand, and figures that answer each move."""
