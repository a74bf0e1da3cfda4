"""The paper's experiments, our figures beside the paper's."""
