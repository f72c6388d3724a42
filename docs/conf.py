# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The documentation site: `sphinx-build -W docs site`, without network."""

from __future__ import annotations

from pathlib import Path
import sys

ROOT = Path(__file__).resolve().parent.parent
# The checkout that holds these pages, whichever pfd_ros is installed.
sys.path[:0] = [str(ROOT), str(ROOT / 'docs')]

from site_pages import filled  # noqa: E402

from pfd_core import __version__  # noqa: E402

project = 'pfd_ros'
author = 'The pfd_ros authors'
release = __version__
html_title = f'pfd_ros {release}'

extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
source_suffix = {'.md': 'markdown', '.rst': 'restructuredtext'}
# Anchors of headings, as GitHub has them.
myst_heading_anchors = 4
# Quotes and dashes as written: most of them are in commands.
smartquotes = False

# Docstrings are written with single backticks for code.
default_role = 'literal'
napoleon_google_docstring = False
# A list, not objects of their own: `q` of one class would be linked from another one.
napoleon_custom_sections = [('Attributes', 'params_style')]
napoleon_use_rtype = False
autodoc_member_order = 'bysource'
autodoc_typehints = 'none'
autodoc_default_options = {'members': True}
toc_object_entries_show_parents = 'hide'

# The theme and its fonts come with the package: no page loads anything from elsewhere.
html_theme = 'furo'
html_theme_options = {'navigation_with_keys': True}
html_static_path = ['static']
html_css_files = ['site.css']
html_copy_source = False
html_show_sourcelink = False
# A page from the disk may not read the other pages, so results have no excerpts.
html_show_search_summary = False


def setup(app) -> None:
    """Fill the sections of README.md and the generated tables into the pages."""
    app.connect('source-read', filled)
