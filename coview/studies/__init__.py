"""Studies that people start and nobody imports. The paper's experiments, and fusion schemes under stress."""
