"""Detection in recordings of clouds, sample by sample, and what it is worth."""
