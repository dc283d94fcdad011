"""Times between packets, from the results of a benchmark.

`benchmarks/results/jitter.json` contains:

    rate            packets sent per second
    seconds         duration of the run
    share_in_band   fraction (0 to 1) of the times between two packets that are in the band
    periods_ms      {"edges": [...], "counts": [...]}, the histogram in milliseconds
"""

from __future__ import annotations

import json
from pathlib import Path

from matplotlib.figure import Figure

SIZE = (7.0, 3.2)
RESULTS = Path(__file__).parents[2] / "benchmarks" / "results" / "jitter.json"
#: Half-width of the band around the period, in ms, which the experiment of the first driver used.
BAND = 0.5


def draw(figure: Figure) -> str:
    """Plot the histogram."""
    results = json.loads(RESULTS.read_text())
    period = 1e3 / results["rate"]
    axes = figure.subplots()
    axes.axvspan(period - BAND, period + BAND, color="0.92", label=f"{period:g} ± {BAND:g} ms")
    axes.stairs(results["periods_ms"]["counts"], results["periods_ms"]["edges"], fill=True, color="#2b6cb0")
    # The counts are from one single packet to tens of thousands, so only a logarithmic axis shows both.
    axes.set(yscale="log", xlabel="time between two packets, ms", ylabel="packets")
    axes.legend()
    return (
        f"Time between two packets at {results['rate']:g} Hz for {results['seconds']:g} s: "
        f"{results['share_in_band']:.2%} are between {period - BAND:g} and {period + BAND:g} ms. "
        "The outermost bars include all times beyond them."
    )
