"""Doctor: what is wrong with a recording, and what to do about it."""
