"""Recordings of clouds as others write them: one file per layout, with its traps."""
