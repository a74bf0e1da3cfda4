"""What recordings of clouds say of their sensors: the empty scene of each, and where it really is."""
