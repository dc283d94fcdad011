from importlib.metadata import version as installed_version

project = "urlink"
author = "The urlink maintainers"
copyright = "The urlink maintainers"
release = version = installed_version("urlink")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]

html_theme = "furo"
html_title = f"urlink {release}"

# Pages link to each other's sections, as they do when read on a forge.
myst_heading_anchors = 3
myst_enable_extensions = ["colon_fence", "deflist"]

autodoc_member_order = "bysource"
