"""Training: packed recordings, examples, losses, loop and second stage."""
