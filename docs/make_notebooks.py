"""Write the notebooks of docs/notebooks/ from their pages, and draw the plots of the pages.

    python docs/make_notebooks.py
    python docs/make_notebooks.py --check
    python docs/make_notebooks.py --plots

Run it after a change of a page. With `--check` it writes nothing, and exits with status 1 if a notebook is out of date.
With `--plots` it also executes the cells in simulated time, and writes the plots that they show.
"""

from __future__ import annotations

import argparse
import sys

from _notebooks import PAGES, cells_of, execute, notebook

import urlink


def main() -> int:
    """Write or check the notebooks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 if a notebook is out of date")
    parser.add_argument("--plots", action="store_true", help="also draw the plots of the pages")
    args = parser.parse_args()
    status = 0
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        path, made = page.with_suffix(".ipynb"), notebook(text)
        if path.exists() and path.read_text(encoding="utf-8") == made:
            continue
        if args.check:
            print(f"{path.name} is out of date; run python docs/make_notebooks.py", file=sys.stderr)
            status = 1
        else:
            path.write_text(made, encoding="utf-8")
    if args.plots:
        _draw()
    return status


def _draw() -> None:
    import matplotlib

    # The live plots need no window.
    matplotlib.use("agg")
    for page in PAGES:
        cells = cells_of(page.read_text(encoding="utf-8"))
        if not any(cell.image for cell in cells):
            continue
        with urlink.simulated_time(seed=1):
            for cell, result in execute(cells):
                if cell.image is not None:
                    path = (page.parent / cell.image).resolve()
                    path.parent.mkdir(exist_ok=True)
                    result.plot.save(path)


if __name__ == "__main__":
    sys.exit(main())
