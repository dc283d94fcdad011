"""A trajectory as a picture; needs matplotlib."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from linkcore.errors import LocalError

from ..models import Model
from ..vectors import JOINTS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .trajectory import Trajectory

__all__ = ["plot"]

#: Places at which the curve is drawn, in all.
_PLACES = 1000
_LABELS = ("position, rad", "speed, rad/s", "acceleration, rad/s²")


def plot(trajectory: Trajectory, model: Model | None) -> Figure:
    """See `Trajectory.plot`."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise LocalError("a plot needs matplotlib: pip install 'urlink[plot]'") from None
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    rows = figure.subplots(3, 1, sharex=True)
    # Accelerations jump at points: one place on each side of them.
    beside = 1e-6 * trajectory.duration
    times = np.unique(
        np.concatenate(
            [
                np.linspace(0.0, trajectory.duration, _PLACES),
                trajectory.time,
                np.clip(trajectory.time - beside, 0.0, None),
                np.clip(trajectory.time + beside, None, trajectory.duration),
            ]
        )
    )
    limits = (None, None, None) if model is None else (None, model.max_speed, model.max_acceleration)
    for axes, values, label, most in zip(rows, trajectory.at(times), _LABELS, limits, strict=True):
        lines = axes.plot(times, values)
        axes.set_ylabel(label)
        if most is not None:
            for line, limit in zip(lines, most.tolist(), strict=True):
                for sign in (-1.0, 1.0):
                    axes.axhline(sign * limit, color=line.get_color(), linestyle="dotted")
    rows[0].plot(trajectory.time, trajectory.q, ".", color="black")
    figure.legend(lines, JOINTS, ncols=len(JOINTS), loc="outside upper center", fontsize="small")
    rows[2].set_xlabel("time, s")
    return figure
