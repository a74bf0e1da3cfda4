"""Training: packed recordings, examples, losses, the loop and the second stage."""
