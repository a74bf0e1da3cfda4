"""Training of the networks. Packed recordings, examples, losses, the loop and the second stage."""
