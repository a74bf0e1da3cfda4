"""Studies: the paper's experiments, and schemes under stress."""
