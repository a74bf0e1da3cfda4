"""Worth of sensors, intervals of figures, places of vehicles."""
