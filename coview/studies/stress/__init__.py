"""What a deployed set of sensors runs into, and how much of its AP is left."""
