"""Sphinx settings. `make docs` builds docs/_build/html; pages in docs/_generated are made anew by generate.py in each build."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "src")]

import generate  # noqa: E402

from undrift import __version__  # noqa: E402

project, author, version, release = "undrift", "The undrift developers", __version__, __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "figures", "**/.*"]
myst_heading_anchors = 4
myst_enable_extensions = ["deflist", "colon_fence"]
autodoc_typehints = "none"  # types stand in the Parameters sections
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
add_module_names = False
highlight_language = "text"
html_theme = "furo"
html_title = "undrift"
html_static_path = ["_static"]
html_css_files = ["undrift.css"]
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_show_copyright = False
smartquotes = False  # an option keeps its two hyphens
html_extra_path = ["calibration.schema.json", *(path.name for path in HERE.glob("*.ipynb"))]
html_theme_options = {"navigation_with_keys": False}
suppress_warnings = ["myst.xref_missing_file_ext"]


# What the theme leaves out for readers with a keyboard or a screen reader: level of headings, names, and a way into what scrolls.
ACCESSIBLE = {
    'class="caption" role="heading"': 'class="caption" role="heading" aria-level="2"',
    '<aside class="sidebar-drawer">': '<aside class="sidebar-drawer" aria-label="Pages">',
    '<aside class="toc-drawer">': '<aside class="toc-drawer" aria-label="On this page">',
    "<pre>": '<pre tabindex="0">',
    "<p><img ": '<p tabindex="0"><img ',
    '<div class="table-wrapper ': '<div tabindex="0" class="table-wrapper ',
}


def make_accessible(app, error):
    """Complete the written pages."""
    if error is None and app.builder.name == "html":
        for page in Path(app.outdir).rglob("*.html"):
            text = page.read_text(encoding="utf-8")
            for was, becomes in ACCESSIBLE.items():
                text = text.replace(was, becomes) if becomes not in text else text
            page.write_text(text, encoding="utf-8")


def setup(app):
    """Make the generated pages before Sphinx looks for pages, and complete what it wrote."""
    app.connect("config-inited", lambda *_: generate.write_all(HERE / "_generated"))
    app.connect("build-finished", make_accessible)
