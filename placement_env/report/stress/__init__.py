"""What a deployed set of sensors meets, and what is left of its AP."""
