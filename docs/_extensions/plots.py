"""The directive `plot`: a figure that is drawn with the library each time the pages are built.

    ```{plot} pressing
    ```

`docs/_plots/pressing.py` draws this figure. Such a module contains the size of the figure in inches, `SIZE`, and a
function `draw`. The function draws on a figure of matplotlib and returns the caption. The caption contains the measured
numbers, so that text and figure always agree. The simulated controllers are stepped, so that the same code gives the
same bytes. `python docs/_extensions/plots.py` draws all figures, or the named ones.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

_DOCS = Path(__file__).parents[1]
_MODULES = _DOCS / "_plots"
_PICTURES = _DOCS / "images" / "plots"
_STYLE = {
    "svg.hashsalt": "urlink",
    "svg.fonttype": "path",
    "font.size": 9,
    "lines.linewidth": 1.2,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}


def draw(name: str) -> tuple[Path, str]:
    """Draw one figure, and return its file and its caption.

    Raises:
        FileNotFoundError: If this checkout does not contain the data of the figure.
    """
    import matplotlib
    from matplotlib.figure import Figure

    matplotlib.use("svg")
    if str(_MODULES) not in sys.path:
        sys.path.insert(0, str(_MODULES))
    module = importlib.import_module(name)
    path = _PICTURES / f"{name}.svg"
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=module.SIZE, layout="constrained")
        caption = module.draw(figure)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, metadata={"Date": None})
    return path, caption


def setup(app: Any) -> dict[str, Any]:
    """Register the directive."""
    from docutils import nodes
    from sphinx.util.docutils import SphinxDirective

    class PlotDirective(SphinxDirective):
        """The figure with its caption, or a sentence if its data is missing."""

        required_arguments = 1

        def run(self) -> list[nodes.Node]:
            """Draw the figure and show it."""
            name = self.arguments[0]
            self.env.note_dependency(str(_MODULES / f"{name}.py"))
            try:
                path, caption = draw(name)
            except FileNotFoundError:
                return [nodes.paragraph("", "This checkout does not contain the results.")]
            image = nodes.image(uri=path.relative_to(_DOCS).as_posix(), alt=caption)
            return [nodes.figure("", image, nodes.caption(caption, caption))]

    app.add_directive("plot", PlotDirective)
    return {"parallel_read_safe": False, "parallel_write_safe": True}


if __name__ == "__main__":
    for each in sys.argv[1:] or sorted(path.stem for path in _MODULES.glob("*.py")):
        print(*draw(each), sep="\n  ")
