"""Settings of the site: `make docs`. Nothing is fetched while it is built, and nothing when it is read."""

from __future__ import annotations

import os
import sys
from importlib.metadata import version as installed
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

project = "hystmpc"
author = "the hystmpc authors"
copyright = "the hystmpc authors, Apache-2.0"
release = version = installed("hystmpc")

extensions = [
    "extension",
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_design",
]
exclude_patterns = ["_build", "extension", "figures/*.py"]
nitpicky = True
# Types of other packages have no page here, nor have internal modules. Public names, `hystmpc.NAME` and
# `hystmpc.ROOM.NAME`, have to be found.
nitpick_ignore_regex = [("py:.*", r"(?!hystmpc\.).*"), ("py:.*", r"hystmpc\.\w+\.\w+\..*")]

# Single back quotes of docstrings: a link where the name is known, else code.
default_role = "py:obj"
highlight_language = "text"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
python_use_unqualified_type_names = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True

myst_heading_anchors = 4
myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist"]

html_theme = "furo"
html_title = f"hystmpc {version}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_search_summary = False  # a summary is fetched, which no browser allows for a page on a disk
smartquotes = False  # two hyphens are those of an option
html_show_sphinx = False
# Fonts of the reader's machine: the theme asks no server for any.

GALLERY = HERE.parent / "examples" / "gallery"
if any(GALLERY.glob("plot_*.py")):
    extensions.append("sphinx_gallery.gen_gallery")
    left_out = [] if find_spec("mujoco") else ["own_simulator"]
    if left_out:
        print("gallery: the page on a simulator of your own is left out, expected mujoco installed: pip install mujoco")
    sphinx_gallery_conf = {
        "examples_dirs": str(GALLERY),
        "gallery_dirs": "gallery",
        "filename_pattern": r"plot_",
        "ignore_pattern": "|".join([r"__init__\.py", *left_out]),
        "within_subsection_order": "FileNameSortKey",
        "run_stale_examples": False,
        "download_all_examples": False,
        "show_memory": False,
        "write_computation_times": False,  # its page asks other hosts for scripts
        "remove_config_comments": True,
        "abort_on_example_error": True,
        "show_signature": False,
        "image_scrapers": ("extension.gallery.figures",),
    }

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")
os.environ["MPLBACKEND"] = "Agg"
