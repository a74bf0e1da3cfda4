"""Searches that prove something: every set of few candidates, integer programmes with bounds, greedy's certificate."""
