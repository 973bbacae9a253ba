"""How Sphinx makes the pages: `sphinx-build -W docs docs/_build`. Nothing is fetched from elsewhere."""

import mpsim

project = "mpsim"
author = "The mpsim developers"
release = mpsim.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["_build"]
nitpicky = False

myst_heading_anchors = 3  # links such as accuracy.md#the-frontier

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_custom_sections = [("Source", "notes_style")]

html_theme = "furo"
html_title = "mpsim"
html_show_sphinx = False
html_copy_source = False
