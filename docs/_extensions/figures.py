"""The directive `jitter`: the histogram of times between packets, drawn from a benchmark's results.

The picture is `images/jitter.svg`. It is drawn from `benchmarks/results/jitter.json` whenever the pages are built and
that file is there; `python docs/_extensions/figures.py` draws it as well. The file holds:

    rate            packets a second that were sent
    seconds         how long they were
    share_in_band   share of the times between two packets that lie in the band, 0 to 1
    periods_ms      {"edges": [...], "counts": [...]}, the histogram in milliseconds
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results" / "jitter.json"
PICTURE = Path(__file__).parents[1] / "images" / "jitter.svg"

#: ms on either side of the period: the band in which the first driver's experiment counted.
BAND = 0.5


def draw(results: dict[str, Any], path: Path) -> None:
    """Draw the histogram; the same results give the same bytes."""
    import matplotlib

    matplotlib.use("svg")
    from matplotlib import pyplot

    period = 1e3 / results["rate"]
    edges, counts = results["periods_ms"]["edges"], results["periods_ms"]["counts"]
    with matplotlib.rc_context({"svg.hashsalt": "urlink", "svg.fonttype": "path"}):
        figure, axes = pyplot.subplots(figsize=(7.0, 3.2), layout="constrained")
        axes.axvspan(period - BAND, period + BAND, color="0.92", label=f"{period:g} ± {BAND:g} ms")
        axes.stairs(counts, edges, fill=True, color="#2b6cb0")
        # Counts from one stray packet to tens of thousands: only a logarithm shows both.
        axes.set_yscale("log")
        axes.set_xlabel("time between two packets, ms")
        axes.set_ylabel("packets")
        axes.legend(frameon=False)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        path.parent.mkdir(exist_ok=True)
        figure.savefig(path, metadata={"Date": None})
        pyplot.close(figure)


def caption(results: dict[str, Any]) -> str:
    """What the picture shows, in figures."""
    period = 1e3 / results["rate"]
    return (
        f"Time between two packets at {results['rate']:g} Hz for {results['seconds']:g} s: "
        f"{results['share_in_band']:.2%} lie between {period - BAND:g} and {period + BAND:g} ms. "
        "The outermost bars hold what lies beyond them."
    )


def setup(app: Any) -> dict[str, Any]:
    """Register the directive."""
    from docutils import nodes
    from sphinx.util.docutils import SphinxDirective

    class JitterDirective(SphinxDirective):
        """The histogram, or a sentence where there are no results."""

        def run(self) -> list[nodes.Node]:
            """Draw it and show it."""
            self.env.note_dependency(str(RESULTS))
            if not RESULTS.exists():
                return [nodes.paragraph("", "This checkout holds no results of it.")]
            results = json.loads(RESULTS.read_text())
            draw(results, PICTURE)
            text = caption(results)
            image = nodes.image(uri=f"images/{PICTURE.name}", alt=text)
            return [nodes.figure("", image, nodes.caption(text, text))]

    app.add_directive("jitter", JitterDirective)
    return {"parallel_read_safe": False, "parallel_write_safe": True}


if __name__ == "__main__":
    draw(json.loads(RESULTS.read_text()), PICTURE)
