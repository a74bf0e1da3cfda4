from . import portfolio as portfolio
