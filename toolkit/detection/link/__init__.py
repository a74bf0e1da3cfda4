"""Links from sensors to the fusion centre: messages as bytes, their delays and load."""
