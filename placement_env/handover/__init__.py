"""What is handed over to those who build: visible ground, sensors as mounted, and files for other programs."""
