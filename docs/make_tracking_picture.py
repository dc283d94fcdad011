"""Draw docs/images/tracking.svg from the output of `python benchmarks/tracking.py --output FILE`.

The same results give the same bytes.
"""

import argparse
import json
from pathlib import Path

import matplotlib

matplotlib.use("svg")

import numpy as np
from _drawing import PLOT_STYLE, plot_text
from matplotlib import pyplot

RESULTS = Path(__file__).parents[1] / "benchmarks" / "results" / "tracking.json"
PICTURE = Path(__file__).parent / "images" / "tracking.svg"


def main() -> None:
    """Draw one column for each controller: positions, error, and difference between runs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--output", type=Path, default=PICTURE)
    args = parser.parse_args()
    args.output.parent.mkdir(exist_ok=True)
    arms = json.loads(args.results.read_text())["arms"]
    with matplotlib.rc_context(PLOT_STYLE):
        figure, rows = pyplot.subplots(
            3, len(arms), figsize=(8.0, 5.6), sharex=True, sharey="row", height_ratios=(3, 2, 1.4), layout="constrained"
        )
        for arm, (position, error, spread) in zip(arms, rows.T, strict=True):
            curves = arm["curves"]
            time, desired = np.array(curves["time"]), np.array(curves["desired"])
            position.set_title(f"{arm['rate']} Hz ({arm['model']}, firmware {arm['firmware']})", fontsize=10)
            for number, actual in enumerate(np.array(curves["actual"])):
                label = f"actual, {arm['runs']} runs" if number == 0 else None
                position.plot(time, actual, color="#2b6cb0", linewidth=1.0, label=label)
                error.plot(time, (actual - desired) * 1e3, color="#2b6cb0", linewidth=0.8)
            position.plot(time, desired, color="black", linewidth=1.0, linestyle=(0, (4, 3)), label="desired")
            spread.plot(time, np.array(curves["spread"]) * 1e3, color="#c05621", linewidth=0.8)
            spread.set_xlabel("controller time, s")
        for axes, label in zip(rows[:, 0], ("tool joint, rad", "actual − desired, mrad", "spread, mrad"), strict=True):
            axes.set_ylabel(label)
        rows[2, 0].set_ylim(bottom=0.0)
        rows[0, 0].legend(frameon=False, loc="upper left")
        args.output.write_text(plot_text(figure))
        pyplot.close(figure)


if __name__ == "__main__":
    main()
