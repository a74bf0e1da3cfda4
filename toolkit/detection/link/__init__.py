"""Links from sensors to the fusion centre."""
