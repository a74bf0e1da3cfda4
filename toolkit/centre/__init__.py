"""Fusion centre that runs: messages of sensors in, tracks out, with a watch over every sensor."""
