"""What stands still at a site, and detectors that know it."""
