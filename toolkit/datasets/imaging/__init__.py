"""Clouds of lidars as range images: which rows and columns a sensor has, and its points in them."""
