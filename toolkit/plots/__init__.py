"""Pictures in one visual language. They are sites from above and curves, with a shared palette,
canvas and symbols."""
