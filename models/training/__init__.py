"""How a network learns: packed recordings, examples, targets, losses, the loop, its checkpoints and its log."""
