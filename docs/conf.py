"""Configuration of Sphinx; ``make docs`` builds the pages.

Nothing is loaded from other hosts: formulas are MathML, pictures are made here, and the theme brings its own fonts.
"""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent)]

import dsbrdf  # noqa: E402 (the folders of the extensions and of the benchmarks come first)

project = "dsbrdf"
author = "the dsbrdf authors"
copyright = f"2026, {author}"  # noqa: A001 (Sphinx's name)
version = release = dsbrdf.__version__

extensions = [
    "myst_nb",  # Markdown pages, and notebooks that are run
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_design",
    "generated_pages",
    "mathml",
    "search_pages",
]
exclude_patterns = ["_build", "generated/*.md"]  # the latter are parts of other pages
templates_path = ["_templates"]
default_role = "autolink"  # a name in backticks leads to its page where it has one
keep_warnings = False
smartquotes = False

autosummary_generate = True
autosummary_imported_members = False
autodoc_typehints = "none"  # docstrings give types and shapes
numpydoc_show_class_members = False  # the templates list them
toc_object_entries_show_parents = "hide"

myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True

html_theme = "pydata_sphinx_theme"
html_title = "dsbrdf"
html_favicon = "_static/icon.svg"
html_static_path = ["_static"]
html_css_files = ["docs.css"]
html_copy_source = False
html_show_sourcelink = False
html_sidebars = {"**": ["site-navigation"]}
html_context = {"default_mode": "auto"}
html_theme_options = {
    "logo": {"text": "dsbrdf", "image_light": "_static/icon.svg", "image_dark": "_static/icon.svg"},
    "navbar_center": [],
    "navbar_persistent": [],
    "navbar_end": ["search-button", "theme-switcher"],
    "navigation_with_keys": False,
    "show_prev_next": True,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
