"""How Sphinx builds the documentation: python -m sphinx -W --keep-going -b html docs runs/docs.

Neither the build nor a built page asks a network for anything: formulas are Unicode, fonts are the reader's own.
"""

import logging
import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

from jupyter_client import KernelManager
from sources import digest_of

from halfseen import __version__

# The processes of notebooks read it when they start.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# The style of highlighting would let every library log to the terminal, if nobody else said where logs go.
logging.getLogger().addHandler(logging.NullHandler())

project = "halfseen"
author = "the halfseen authors"
copyright = "the halfseen authors, Apache-2.0"  # noqa: A001
version = release = __version__
language = "en-GB"

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc"]
extensions += ["citations", "public_names", "published_tables", "read_aloud", "timings_table", "verbs"]
exclude_patterns = ["extensions", "pictures", "_build"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
# The processes of notebooks are talked with in cipher, or each would warn that they are not.
KernelManager.transport_encryption.default_value = "auto"
# What a notebook shows is kept until it, the package or the logs change.
nb_execution_mode = "cache"
root = Path(__file__).parents[1]
nb_execution_cache_path = str(root / "runs" / "notebooks" / digest_of(root, "src/halfseen", "examples"))
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True
# Docstrings put names between single backticks; those that are public become links.
default_role = "py:obj"
# A reference that a page does not cite is no fault: the docstrings of private modules cite some.
suppress_warnings = ["ref.citation"]

autosummary_generate = False
autodoc_class_signature = "mixed"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints_format = "short"
add_module_names = False
toc_object_entries_show_parents = "hide"
python_maximum_signature_line_length = 88
python_use_unqualified_type_names = True
numpydoc_show_class_members = False

html_theme = "furo"
html_title = "halfseen"
html_static_path = ["static"]
html_css_files = ["halfseen.css"]
html_copy_source = False
html_show_sphinx = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#1f5f8b", "color-brand-content": "#1f5f8b"},
    "dark_css_variables": {"color-brand-primary": "#7fb8dd", "color-brand-content": "#7fb8dd"},
    "navigation_with_keys": True,
}
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"
