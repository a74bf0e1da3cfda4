"""The drawings of a plan, as SVG text: maps of the site and charts of the figures."""
