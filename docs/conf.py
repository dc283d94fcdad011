import sys
from importlib.metadata import version as installed_version
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))

project = "urlink"
author = "The urlink maintainers"
copyright = "The urlink maintainers"
release = version = installed_version("urlink")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "compatibility",
    "dashboard",
    "drives",
    "figures",
    "functions",
    "layouts",
    "packages",
]
exclude_patterns = ["_build", "_extensions"]

html_theme = "furo"
html_title = f"urlink {release}"

# Pages link to each other's sections, as they do when read on a forge.
myst_heading_anchors = 3
myst_enable_extensions = ["colon_fence", "deflist"]

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
