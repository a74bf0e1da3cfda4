"""Pictures in one visual language: sites from above, curves, and the palette, canvas and symbols they share."""
