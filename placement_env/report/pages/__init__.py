"""The report for readers. One document becomes a page for browsers, with the junction in 3D, and a
PDF."""
