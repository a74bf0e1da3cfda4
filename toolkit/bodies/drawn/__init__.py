"""Bodies drawn afresh from continuous proportions: cars, heavy vehicles, two-wheelers, people."""
