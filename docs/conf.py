"""Configuration of Sphinx: `make docs` builds these pages into out/docs. No page needs the
network."""

import sys
from importlib import metadata
from pathlib import Path

HERE = Path(__file__).parent
# the checkout before what is installed; the extensions beside this file
sys.path[:0] = [str(HERE.parent), str(HERE)]

project = "coview"
author = "the authors of coview"
try:
    release = metadata.version("coview")
except metadata.PackageNotFoundError:  # a checkout that is not installed
    release = ""

extensions = ["myst_nb", "sphinx.ext.autodoc", "faces", "commands"]
exclude_patterns = ["_build"]
nb_execution_mode = "off"  # `docs/notebooks/execute.py` runs them, and keeps what they show
nb_merge_streams = True
suppress_warnings = ["misc.highlighting_failure"]
nitpicky = False
highlight_language = "text"  # of blocks that name none: command lines

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
myst_links_external_new_tab = False

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
maximum_signature_line_length = 90
python_use_unqualified_type_names = True
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = f"coview {release}".strip()
html_static_path = ["_static"]
html_css_files = ["coview.css"]
html_show_sphinx = False
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {"navigation_with_keys": True}
