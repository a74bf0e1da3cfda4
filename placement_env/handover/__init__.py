"""Results for builders and installers: visible ground, sensors as mounted, and files for other
programs.
"""
