"""Worth of sensors, intervals of figures, and the places of vehicles on the roads."""
