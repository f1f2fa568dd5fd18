"""The site: `sphinx-build -W -n --keep-going docs site`. Pages in Markdown, the reference from
docstrings and records.
"""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [
    str(HERE),
    str(HERE.parent),
]  # the two modules beside this file, and the package of this checkout

import pixsim  # noqa: E402

project = "pixsim"
author = "the pixsim developers"
release = version = pixsim.__version__
html_title = f"pixsim {release}"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.viewcode",
    "from_docstrings",
    "from_markdown",
]
exclude_patterns = ["pictures", "**/.*"]
default_role = "name_or_code"  # of from_docstrings
myst_heading_anchors = 4  # as GitHub names them

autodoc_member_order = "bysource"
# Of properties; from_docstrings writes the signatures of functions.
autodoc_type_aliases = {name: name for name in ("Array", "Floats")}
viewcode_follow_imported_members = True
python_use_unqualified_type_names = True
maximum_signature_line_length = 72
python_display_short_literal_types = True
add_module_names = False
modindex_common_prefix = ["pixsim."]

smartquotes = False

html_theme = "furo"  # no fonts and no scripts from elsewhere
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
html_static_path = ["style"]
html_css_files = ["site.css"]
pygments_style = "tango"
