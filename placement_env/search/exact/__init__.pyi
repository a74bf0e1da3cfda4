from . import cheapest as cheapest, cpsat as cpsat, exhaustive as exhaustive, hits as hits
