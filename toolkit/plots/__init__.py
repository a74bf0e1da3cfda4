"""Pictures in one visual language: sites from above, curves; palette, canvas and symbols that other pictures use."""
