import re
import sys
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

from docutils import nodes

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

project = "urlink"
author = "The urlink maintainers"
copyright = "The urlink maintainers"
release = version = installed_version("urlink-robot")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "compatibility",
    "dashboard",
    "drawings",
    "drives",
    "functions",
    "layouts",
    "lives",
    "missions",
    "navigation",
    "packages",
    "parameters",
    "plots",
    "references",
    "signatures",
    "summary",
    "variables",
]
# Attributes are entries of a list. As a link target, an attribute such as `GripperStatus.object` would also be the
# target of each type `object`.
napoleon_use_ivar = True
# tables: for readers of the repository, who do not see the output of directives
exclude_patterns = ["_build", "_extensions", "_plots", "tables"]

html_theme = "furo"
# Without the commit of a development version.
html_title = f"urlink {release.partition('.dev')[0]}"
html_logo = "_static/logo.svg"
html_favicon = "_static/logo.svg"
html_static_path = ["_static"]
html_css_files = ["style.css"]

# The copy button copies only the text that a user types.
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

# Pages link to sections of other pages. The same links work on the web page of a repository.
myst_heading_anchors = 3
myst_enable_extensions = ["attrs_block", "colon_fence", "deflist"]

# A name in single backticks is code, and a link if the API reference contains it.
default_role = "name"

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"


def strip_blocks(app: Any, document: Any) -> None:
    """Remove the empty line at the end of examples, which only doctest needs."""
    for block in document.findall(nodes.literal_block):
        text = block.astext().rstrip("\n")
        # A block is highlighted only if its source is equal to its text.
        block.rawsource = text
        block.children = []
        block += nodes.Text(text)


def drop_links_to_tables(app: Any, docname: str, source: list[str]) -> None:
    """Remove the links to docs/tables/, because the built page contains the tables."""
    source[0] = re.sub(r"\n?If you read this page in the repository[^)]*\)\.", "", source[0])


def setup(app: Any) -> None:
    """Register the functions above; called by Sphinx."""
    app.connect("source-read", drop_links_to_tables)
    app.connect("doctree-read", strip_blocks)
