"""The directive `plot`: a figure that is drawn whenever the pages are built, from what the library does.

    ```{plot} pressing
    ```

`docs/_plots/pressing.py` draws it. Such a module has the size of its figure in inches, `SIZE`, and a function `draw`,
which draws on a figure of matplotlib and returns the caption; with the numbers that it has measured, so that the text
cannot say others than the figure shows. The simulated controllers that they look at are stepped, so that the same code
gives the same bytes. `python docs/_extensions/plots.py` draws them all, or those that it is given by name.
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
    """Draw one figure: its file, and its caption.

    Raises:
        FileNotFoundError: what it is drawn from is not in this checkout.
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
        """The figure with its caption, or a sentence where there is nothing to draw it from."""

        required_arguments = 1

        def run(self) -> list[nodes.Node]:
            """Draw it and show it."""
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
