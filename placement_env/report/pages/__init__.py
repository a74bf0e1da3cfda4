"""The report for readers: one document as a page for browsers, with the junction in 3D, and as a PDF."""
