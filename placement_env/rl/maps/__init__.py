"""Policies that know a site by its map alone: their network, what they are taught, their training, their answers."""
