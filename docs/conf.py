"""Sphinx's settings for the site: `make docs`. The recipe in the Makefile gathers the sources in one folder first.

Theme: furo, because it is maintained, small (0.6 MB), made for narrow screens too, and loads nothing from elsewhere.
"""

import pkgutil
import sys
from pathlib import Path

import tras

sys.path.insert(0, str(Path(__file__).parent))  # blocks.py

project, author, release = "tras", "The tras authors", tras.__version__
copyright = "The tras authors, MIT License"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.viewcode", "numpydoc", "blocks"]
exclude_patterns = ["figures", "tras", "**/results"]
suppress_warnings = ["config.cache"]

# --- the page: readable without network, from a disk ------------------------------------------------------------------

html_theme = "furo"
html_title = "tras"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"  # blocks.py
html_copy_source = html_show_sourcelink = False
html_show_search_summary = False  # would be fetched, which a browser refuses for pages on a disk
html_last_updated_fmt = None  # the same sources give the same pages
pygments_style, pygments_dark_style = "tango", "monokai"

# --- text and notebooks -----------------------------------------------------------------------------------------------

smartquotes = False  # text stands as it is written
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # the notebooks are those that make has executed
nb_ipywidgets_js = {}  # it would come from elsewhere
nb_merge_streams = True

tras_pages = ["index", "replication", "claims", "dictionaries"]  # those with lookups in them

# --- the reference, from the docstrings -------------------------------------------------------------------------------

autosummary_generate = True
templates_path = [str(Path(__file__).parent / "templates")]  # autosummary looks from the folder of the sources
autodoc_typehints = "none"  # the docstrings have types, with shapes and units
autodoc_member_order = "bysource"
numpydoc_show_class_members = False  # the template lists them, with their docstrings
default_role = "py:obj"  # `tras.smooth` in a docstring is a link
# A name that is not on the site stands as code; one that looks like a public name and is not there is a mistake.
nitpick_ignore = [("py:obj", f"tras.{module.name}") for module in pkgutil.iter_modules(tras.__path__)]
nitpick_ignore_regex = [("py:obj", r"(?!tras\.\w+$).*"), ("py:class", r"(?!tras\.).*")]
