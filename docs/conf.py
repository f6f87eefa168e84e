"""Sphinx configuration of the documentation; ``scripts/docs`` builds it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE / "_extensions"), str(HERE.parent)]
os.environ["PYTHONPATH"] = os.pathsep.join([str(HERE.parent), os.environ.get("PYTHONPATH", "")])  # of the notebooks
os.environ.setdefault("OMP_NUM_THREADS", "1")  # of the notebooks: their batches are small

import torchrl_atr  # noqa: E402

project = "torchrl_atr"
author = "The torchrl_atr contributors"
copyright = author
version = release = torchrl_atr.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.githubpages",  # the site works on GitHub Pages, too
    "sphinx.ext.napoleon",
    "public_api",
]
exclude_patterns = ["_build"]
templates_path = ["_templates"]
smartquotes = False  # quotation marks stay as they are written

html_theme = "pydata_sphinx_theme"
html_title = "torchrl_atr"
html_theme_options = {"show_prev_next": False, "navigation_with_keys": False, "secondary_sidebar_items": ["page-toc"]}
html_show_sourcelink = False

myst_heading_anchors = 3
nb_execution_mode = "force"  # when a notebook or its page is read anew
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_output_stderr = "remove"  # hints of libraries about widgets; an exception still fails the build

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 100
napoleon_use_ivar = True  # Attributes: of a class stay a list, beside the members that have docstrings of their own
napoleon_attr_annotations = False
