"""What to build: candidates, objective, environments and searches."""
