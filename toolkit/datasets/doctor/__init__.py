"""The doctor: classic mistakes of recordings, found and explained."""
