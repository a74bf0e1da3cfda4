"""Results for builders and installers. They are visible ground, sensors as mounted, and files for
other programs."""
