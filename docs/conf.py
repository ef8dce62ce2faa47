"""How Sphinx makes a site of the guides: `make docs`, without a network."""

project = "jaxmpc"
extensions = ["myst_nb"]
html_theme = "furo"
html_title = "jaxmpc"
html_show_copyright = False
exclude_patterns = ["build"]
nb_execution_mode = (
    "off"  # tests/docs/test_site.py runs the notebook; the site shows its cells, which are kept without outputs
)
myst_heading_anchors = 3
suppress_warnings = ["myst.xref_missing"]  # links to files of the repository are no pages of the site
html_static_path: list[str] = []
