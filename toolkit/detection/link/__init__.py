"""Links from sensors to the fusion centre. Messages as bytes, their delays and load."""
