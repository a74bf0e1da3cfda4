# Scripts beside the tests: they import each other by name and are run by test_mutations.py in
# processes of their own.
collect_ignore = [
    *("formats.py", "layout_formats.py", "map_formats.py", "mutants.py", "named_damage.py"),
    *("network_formats.py", "plan_formats.py", "point_formats.py", "run.py", "structured.py"),
    "track_formats.py",
]
