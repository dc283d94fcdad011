"""Plots of columns over time, with one panel for each field and one line for each element of the field."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import clock
from ..errors import BadRecording, BadValue
from ..names import StrictAttributes, needs

#: Maximum number of points of a line. For a longer line, only the minimum and maximum of each section are drawn.
_MOST_POINTS = 8000
#: Shortest time in s that a window gets for its events. Matplotlib would interpret 0 as no limit.
SHORTEST = 0.01
#: Elements of a pose, a speed or a force, which have two units ("m, rad").
_SPATIAL = ("x", "y", "z", "rx", "ry", "rz")
#: Units of vectors in space.
_OF_VECTORS = frozenset({"m", "m/s", "m/s^2", "N", "Nm"})
#: Number of lines in one column of the legend of a panel.
_COLUMN = 8
_SUFFIXES = (".png", ".svg", ".pdf")


class Curves(NamedTuple):
    """Values of one field over time.

    Attributes:
        name: Name of the field.
        unit: Unit of the values.
        time: Time of each row, shape (n,), in s.
        values: Numbers, shape (n,) or (n, k).
    """

    name: str
    unit: str
    time: NDArray[np.float64]
    values: NDArray[Any]


def element_names(unit: str, count: int) -> tuple[str, ...]:
    """Return the names of the elements of a vector for a legend.

    For a vector in space, they are the names of the axes, with the unit of each axis if there are two units. For any
    other vector, they are the numbers of the elements.

    >>> element_names("m, rad", 6)
    ('x, m', 'y, m', 'z, m', 'rx, rad', 'ry, rad', 'rz, rad')
    >>> element_names("N", 3), element_names("rad", 2)
    (('x', 'y', 'z'), ('0', '1'))
    """
    first, comma, second = unit.partition(", ")
    if comma and count == len(_SPATIAL):
        return tuple(f"{name}, {first if number < 3 else second}" for number, name in enumerate(_SPATIAL))
    if unit in _OF_VECTORS and count == 3:
        return _SPATIAL[:3]
    return tuple(map(str, range(count)))


class Plot(StrictAttributes):
    """Plot of fields over time: save it, show it in a window, or let a notebook show it.

    Args:
        curves: Fields to plot, in order from the top.
        title: Title above the panels.

    Raises:
        BadValue: If there is no field, or if a field is not numeric.
    """

    def __init__(self, curves: Sequence[Curves], title: str = "") -> None:
        if not curves:
            raise BadValue("nothing to plot; name one field or more, such as q_actual")
        for each in curves:
            if each.values.dtype.kind not in "fiub":
                raise BadValue(f"{each.name} is not a numeric field, so it cannot be plotted")
        self._curves = list(curves)
        self._title = title

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the plot to a .png, .svg or .pdf file.

        Raises:
            BadValue: If `path` has another suffix.
            BadRecording: If the file cannot be written.
            LocalError: If matplotlib is not installed.
        """
        path = Path(path)
        if path.suffix.lower() not in _SUFFIXES:
            raise BadValue(f"{path}: unsupported type of file; expected one of {', '.join(_SUFFIXES)}")
        try:
            self.figure().savefig(path, bbox_inches="tight")
        except OSError as error:
            raise BadRecording(f"cannot write {path}: {error.strerror or error}") from error
        return path

    def show(self) -> None:
        """Show the plot in a window, and wait until the window is closed.

        Raises:
            LocalError: If matplotlib is not installed.
        """
        with needs("plot", "a plot"):
            from matplotlib import pyplot
        self.draw(pyplot.figure(figsize=self.size))
        pyplot.show()

    def figure(self) -> Any:
        """Return the plot as a `matplotlib.figure.Figure`.

        Raises:
            LocalError: If matplotlib is not installed.
        """
        with needs("plot", "a plot"):
            # Not pyplot: it would choose a window system for the whole program.
            from matplotlib.backends.backend_agg import FigureCanvasAgg
            from matplotlib.figure import Figure
        figure = Figure(figsize=self.size, dpi=100)
        FigureCanvasAgg(figure)
        self.draw(figure)
        return figure

    @property
    def size(self) -> tuple[float, float]:
        """Width and height, in inches."""
        return 9.0, 0.8 + 1.9 * len(self._curves)

    def draw(self, figure: Any) -> None:
        """Draw the plot into a figure of matplotlib."""
        panels = figure.subplots(len(self._curves), 1, sharex=True, squeeze=False)[:, 0]
        for panel, each in zip(panels, self._curves, strict=True):
            columns = each.values.reshape(len(each.time), -1).astype(float).T
            for name, column in zip(element_names(each.unit, len(columns)), columns, strict=True):
                panel.plot(*_thinned(each.time, column), linewidth=1.0, label=name)
            panel.set_title(each.name, loc="left", fontsize="medium")
            panel.set_ylabel("" if each.unit == "1" else each.unit)
            panel.grid(alpha=0.3)
            if len(columns) > 1:
                panel.legend(
                    loc="upper left",
                    bbox_to_anchor=(1.0, 1.0),
                    fontsize="small",
                    frameon=False,
                    ncols=-(-len(columns) // _COLUMN),
                )
        panels[-1].set_xlabel("t [s]")
        if self._title:
            figure.suptitle(self._title)

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.figure().savefig(buffer, format="png", bbox_inches="tight")
        return buffer.getvalue()

    def __repr__(self) -> str:
        return f"<Plot of {', '.join(each.name for each in self._curves)}>"


def _thinned(time: NDArray[np.float64], values: NDArray[np.float64]) -> tuple[Any, Any]:
    """Return the minimum and maximum of each section of a long line, so that no peak is lost."""
    if len(time) <= _MOST_POINTS:
        return time, values
    stretch = 2 * len(time) // _MOST_POINTS
    count = len(time) // stretch
    pieces = values[: count * stretch].reshape(count, stretch)
    # fmin and fmax ignore NaN. A column has a NaN for each lost connection.
    ends = np.stack([np.fmin.reduce(pieces, axis=1), np.fmax.reduce(pieces, axis=1)], axis=1).ravel()
    return np.repeat(time[: count * stretch : stretch], 2), ends


def is_in_notebook() -> bool:
    """Whether this program runs in the kernel of a notebook."""
    # A notebook has imported IPython already, so this function does not have to import it.
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    return shell is not None and hasattr(shell, "kernel")


class LivePlot:
    """Display that shows one plot after the other: below the cell of a notebook, or else in a window.

    Raises:
        LocalError: If matplotlib is not installed.
    """

    def __init__(self) -> None:
        self._handle: Any = None
        self._figure: Any = None
        # Import matplotlib before states are received, because the first import takes seconds.
        with needs("plot", "a live plot"):
            if is_in_notebook():
                from matplotlib import figure  # noqa: F401
            else:
                from matplotlib import pyplot

                self._pyplot = pyplot

    def update(self, plot: Plot, pause: float) -> None:
        """Replace the previous plot by this one, and give the window `pause` seconds for its events."""
        if is_in_notebook():
            from IPython.display import display

            if self._handle is None:
                self._handle = display(plot, display_id=True)
            else:
                self._handle.update(plot)
            clock.sleep(pause)
            return
        if self._figure is None:
            self._figure = self._pyplot.figure(figsize=plot.size)
        self._figure.clear()
        plot.draw(self._figure)
        if self._pyplot.get_backend().lower() == "agg":
            clock.sleep(pause)  # there is no window, so there are no events
        else:
            self._pyplot.pause(pause)

    def close(self) -> None:
        """Close the window. A plot in a notebook stays visible."""
        if self._figure is not None:
            self._pyplot.close(self._figure)
