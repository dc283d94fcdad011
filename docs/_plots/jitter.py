"""The times between packets, from a benchmark's results.

`benchmarks/results/jitter.json` holds:

    rate            packets a second that were sent
    seconds         how long they were
    share_in_band   share of the times between two packets that lie in the band, 0 to 1
    periods_ms      {"edges": [...], "counts": [...]}, the histogram in milliseconds
"""

from __future__ import annotations

import json
from pathlib import Path

from matplotlib.figure import Figure

SIZE = (7.0, 3.2)
RESULTS = Path(__file__).parents[2] / "benchmarks" / "results" / "jitter.json"
#: ms on either side of the period: the band in which the first driver's experiment counted.
BAND = 0.5


def draw(figure: Figure) -> str:
    """The histogram."""
    results = json.loads(RESULTS.read_text())
    period = 1e3 / results["rate"]
    axes = figure.subplots()
    axes.axvspan(period - BAND, period + BAND, color="0.92", label=f"{period:g} ± {BAND:g} ms")
    axes.stairs(results["periods_ms"]["counts"], results["periods_ms"]["edges"], fill=True, color="#2b6cb0")
    # Counts from one stray packet to tens of thousands: only a logarithm shows both.
    axes.set(yscale="log", xlabel="time between two packets, ms", ylabel="packets")
    axes.legend()
    return (
        f"Time between two packets at {results['rate']:g} Hz for {results['seconds']:g} s: "
        f"{results['share_in_band']:.2%} are between {period - BAND:g} and {period + BAND:g} ms. "
        "The outermost bars include all times beyond them."
    )
