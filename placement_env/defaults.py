"""Usual conditions of an objective: vehicles count, in the one case of intact sensors."""

from placement_env.cases import Cases
from placement_env.classes import Classes

VEHICLES = Classes()
USUAL_CASES = Cases()
