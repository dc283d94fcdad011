"""Plots of the measured quantities as SVG, for the page: rate, jitter, positions and forces over time."""

from __future__ import annotations

import html
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from urlink.tools import JOINTS

from .arrivals import moments
from .evidence import Came, Evidence
from .requirements import NotTried

_WIDTH, _HEIGHT, _LEFT, _BELOW = 640, 150, 60, 22
#: Maximum number of points of a line.
_POINTS = 500
_COLOURS = ("#1b6ca8", "#c8553d", "#588157", "#7b4b94", "#b08900", "#444444")
Values = NDArray[np.float64]
#: A line: name, times in s, values.
_Line = tuple[str, Values, Values]


def plots(evidence: Evidence) -> str:
    """Return the plots as HTML. A quantity that was not received has no plot."""
    made = (
        ("Packets per second", list(_rates(evidence))),
        ("Delay after the quickest packet, in ms", list(_delays(evidence))),
        ("Joint positions q_actual, in rad", list(_columns(evidence.realtime, "q_actual", JOINTS))),
        ("Force tcp_force, in N", list(_columns(evidence.realtime, "tcp_force", ("x", "y", "z")))),
    )
    begin = min((float(line[1][0]) for _, lines in made for line in lines), default=0.0)
    return "".join(_plot(title, lines, begin) for title, lines in made if lines)


def _rates(evidence: Evidence) -> Iterator[_Line]:
    for name in ("realtime", "rtde", "primary"):
        arrived = getattr(evidence, name).arrived
        if len(arrived) > 1 and arrived[-1] - arrived[0] >= 2.0:
            edges = np.arange(arrived[0], arrived[-1], 1.0)
            yield name, edges[:-1] + 0.5, np.histogram(arrived, edges)[0].astype(np.float64)


def _delays(evidence: Evidence) -> Iterator[_Line]:
    for name in ("realtime", "rtde"):
        packets: Came = getattr(evidence, name)
        try:
            delays = packets.arrived - moments(name, packets)
        except NotTried:
            continue
        if np.isfinite(delays).all():
            yield name, packets.arrived, 1e3 * (delays - delays.min())


def _columns(packets: Came, field: str, names: Sequence[str]) -> Iterator[_Line]:
    values = packets.column(lambda state: getattr(state, field))
    if values is not None:
        for number, name in enumerate(names):
            is_number = np.isfinite(values[:, number])
            if is_number.any():
                yield name, packets.arrived[is_number], values[is_number, number]


def _thinned(times: Values, values: Values) -> tuple[Values, Values]:
    """Keep the smallest and the largest value of each interval, so that peaks remain visible."""
    size = -(-2 * len(times) // _POINTS)
    if size < 2:
        return times, values
    count = len(times) // size
    rows = values[: count * size].reshape(count, size)
    both = np.stack([rows.min(axis=1), rows.max(axis=1)], axis=1).ravel()
    return np.repeat(times[: count * size : size], 2), both


def _plot(title: str, lines: Sequence[_Line], begin: float) -> str:
    low = min(float(values.min()) for _, _, values in lines)
    high = max(float(values.max()) for _, _, values in lines)
    end = max(float(times[-1]) for _, times, _ in lines)
    height, width = max(high - low, 1e-9), max(end - begin, 1e-9)
    drawn = []
    for (name, *line), colour in zip(lines, _COLOURS, strict=False):
        times, values = _thinned(*line)
        x = _LEFT + (times - begin) / width * (_WIDTH - _LEFT - 10)
        y = 10 + (high - values) / height * (_HEIGHT - _BELOW - 10)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
        drawn.append(f'<polyline fill="none" stroke="{colour}" points="{points}"><title>{name}</title></polyline>')
    names = zip(lines, _COLOURS, strict=False)
    legend = " ".join(f'<span style="color:{colour}">{html.escape(line[0])}</span>' for line, colour in names)
    bottom = _HEIGHT - _BELOW
    return (
        f"<figure><figcaption>{title}: {legend}</figcaption>"
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" width="100%" font-size="10" role="img" aria-label="{title}">'
        f'<path d="M{_LEFT} 10V{bottom}H{_WIDTH - 10}" fill="none" stroke="#999"/>'
        f'<text x="{_LEFT - 4}" y="16" text-anchor="end">{high:.4g}</text>'
        f'<text x="{_LEFT - 4}" y="{bottom}" text-anchor="end">{low:.4g}</text>'
        f'<text x="{_LEFT}" y="{_HEIGHT - 6}">0 s</text>'
        f'<text x="{_WIDTH - 10}" y="{_HEIGHT - 6}" text-anchor="end">{width:.1f} s</text>'
        f"{''.join(drawn)}</svg></figure>\n"
    )
