"""Commands about what to build: searched, planned, reproduced."""
