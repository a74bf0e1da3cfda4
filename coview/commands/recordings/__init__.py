"""Commands about sites and recordings."""
