"""A drawn street's furniture: trees over the road, bays along its kerbs, road works, things as big as cars."""
