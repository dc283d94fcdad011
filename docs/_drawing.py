"""Shared parts of the drawings and plots of these pages: colours that follow the page's theme, and styles.

A drawing is a separate file. The web page of a repository shows it directly, in the colours that the reader's system
requests. In the built pages, it becomes a part of the page (`_extensions/drawings.py`), with the colours of the theme.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["COLOURS", "PLOT_STYLE", "drawing", "plot_text"]

#: One colour for each joint or kind of item; they can be distinguished on white and on black.
COLOURS = ("#4a7fc0", "#e07a1f", "#2f9e76", "#d0575a", "#8f6fc0", "#b59b2d")

#: Settings of matplotlib for a plot, with which equal results give equal bytes.
PLOT_STYLE: dict[str, Any] = {
    "svg.hashsalt": "urlink",
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
}

_THEME = """
{scope} {{ --ink: var(--color-foreground-primary, #1f2933); --faint: var(--color-foreground-muted, #6b7680);
  --line: var(--color-background-border, #dde2e7); --paper: var(--color-background-primary, #ffffff);
  --panel: var(--color-background-secondary, #f6f8fa); }}
@media (prefers-color-scheme: dark) {{ {scope} {{ --ink: var(--color-foreground-primary, #e6e9ec);
  --faint: var(--color-foreground-muted, #98a2ad); --line: var(--color-background-border, #3a4149);
  --paper: var(--color-background-primary, #131416); --panel: var(--color-background-secondary, #1d2023); }} }}
{scope} text {{ font: 13px system-ui, sans-serif; fill: var(--ink); }}
{scope} path, {scope} polyline, {scope} line {{ fill: none; stroke-linecap: round; stroke-linejoin: round; }}
"""


def drawing(name: str, width: float, height: float, title: str, style: str, body: Iterable[str]) -> str:
    """Return the text of a drawing.

    Args:
        name: Name of the file. It is also a class of the drawing, and each rule of `style` applies only within it.
            Without this, the rules of a drawing would apply to the whole page that contains it.
        width: Width of the coordinates in `body`.
        height: Height of the coordinates in `body`.
        title: Description for readers who do not see the drawing.
        style: Rules of CSS, one per line.
        body: Elements of SVG.
    """
    scope = f".drawing-{name}"
    scoped = re.sub(r"^(?=[.a-z])", f"{scope} ", style.strip(), flags=re.MULTILINE)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" class="drawing drawing-{name}"'
        ' role="img">',
        f"<title>{title}</title>",
        f"<style>{_THEME.format(scope=scope).strip()}\n{scoped}</style>",
        *body,
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def plot_text(figure: Figure) -> str:
    """Return a plot of matplotlib as SVG, without a date."""
    drawn = io.StringIO()
    figure.savefig(drawn, format="svg", metadata={"Creator": None, "Date": None})
    # Keep hundredths of a point: a reader cannot see more, and the file has only a third of the bytes.
    return re.sub(r"(\d\.\d\d)\d+", r"\1", drawn.getvalue())
