"""Studies that people start and nobody imports: the paper's experiments, and fusion schemes under stress."""
