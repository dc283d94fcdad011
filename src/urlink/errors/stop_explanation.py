"""`StopExplanation`: why the robot stopped, as data, as text and as a picture."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from html import escape
from pathlib import Path
from typing import Any

from linkcore.errors import BadRecording, BadValue

#: Characters of a curve in the terminal, from the smallest to the largest value.
_BARS = " ▁▂▃▄▅▆▇█"
#: Number of characters of a curve in the terminal.
_WIDTH = 60
#: Colours of the curves, distinguishable also without red and green.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
#: Sizes in the picture in pixels: width and height of a panel, space on the left, for the legend, and between panels.
_PANEL, _HEIGHT, _LEFT, _LEGEND, _GAP = 560, 130, 64, 110, 34


@dataclass(frozen=True)
class StopCause:
    """Possible cause of a stop.

    Attributes:
        name: Name of the cause, such as "contact" or "joint speed".
        score: Weight of the evidence, 0 to 1. It is not a probability.
        text: What happened, as a sentence.
        evidence: Observations that support this cause.
        remedy: What to do, as a sentence.
        joint: Name of the joint; None if the cause is not a matter of one joint.
        value: Value of the quantity that exceeded its limit; None if it is unknown.
        limit: Limit of this quantity, or its largest normal value if the controller's limit is not published; None if
            both are unknown.
        unit: Unit of both.
    """

    name: str
    score: float
    text: str
    evidence: tuple[str, ...] = ()
    remedy: str = ""
    joint: str | None = None
    value: float | None = None
    limit: float | None = None
    unit: str = ""

    @property
    def exceeded_by(self) -> float | None:
        """How far the value exceeded the limit, in `unit`; None if a number is unknown, negative if it did not."""
        return None if self.value is None or self.limit is None else self.value - self.limit


@dataclass(frozen=True)
class StopCurves:
    """Curves of one quantity in the last second before a stop.

    Attributes:
        name: Name of the quantity.
        unit: Unit of the values.
        labels: Name of each curve.
        time: Times relative to the stop, in s.
        values: Values of each curve, one sequence for each label.
        limit: Limit of the quantity, drawn as a dashed line; None if it has none or if it is unknown.
    """

    name: str
    unit: str
    labels: tuple[str, ...]
    time: tuple[float, ...]
    values: tuple[tuple[float, ...], ...]
    limit: float | None = None


@dataclass(frozen=True)
class StopExplanation:
    """Why the robot stopped. Made by `robot.safety.explain()`, `SafetyStop.explanation` and `Recording.explain()`.

    Attributes:
        kind: Name of the stop, such as "protective stop" or "program stopped".
        causes: Possible causes, with the best supported one first. At least one; its name might be "unknown".
        at: Time of the stop in seconds: of `linkcore.clock.now` for a live robot, since the start of a recording.
        code: Code of the controller, such as "C153A1"; None if no code was received.
        code_text: Meaning of the code in our own words; None if no code was received, or if it is unknown.
        code_source: Source of the meaning.
        code_evidence: Kind of evidence for the meaning: "document" or "thread".
        commanded: What was commanded at the time of the stop, one string each.
        missing: Data that would have helped and were not there, one string each.
        curves: Curves of the last second, for the picture.
    """

    kind: str
    causes: tuple[StopCause, ...]
    at: float | None = None
    code: str | None = None
    code_text: str | None = None
    code_source: str | None = None
    code_evidence: str | None = None
    commanded: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    curves: tuple[StopCurves, ...] = field(default=(), repr=False)

    @property
    def cause(self) -> StopCause:
        """Best supported cause."""
        return self.causes[0]

    def __str__(self) -> str:
        cause = self.cause
        code = f", {self.code}" if self.code else ""
        return f"{self.kind}{code}: {cause.name}. {cause.text}"

    def text(self, *, picture: bool = True) -> str:
        """Return the whole explanation as lines of text.

        Args:
            picture: Whether to add the curves of the last second, as characters.
        """
        cause = self.cause
        when = "" if self.at is None else f" at {self.at:.3f} s"
        lines = [f"{self.kind}{when}: {cause.name}", f"  what happened: {cause.text}"]
        if cause.exceeded_by is not None:
            lines.append(
                f"  limit:         {cause.value:.4g} {cause.unit}, limit {cause.limit:.4g} {cause.unit}, "
                f"exceeded by {cause.exceeded_by:.3g} {cause.unit}"
                if cause.exceeded_by > 0
                else f"  limit:         {cause.value:.4g} {cause.unit} of {cause.limit:.4g} {cause.unit}"
            )
        if self.code is not None:
            meaning = self.code_text or "not in the table of codes"
            lines.append(f"  code:          {self.code}: {meaning}")
            if self.code_source:
                lines.append(f"                 (source: {self.code_source})")
        lines += [f"  evidence:      {each}" for each in cause.evidence]
        lines += [f"  commanded:     {each}" for each in self.commanded]
        if cause.remedy:
            lines.append(f"  what to do:    {cause.remedy}")
        others = [f"{each.name} ({each.score:.2f})" for each in self.causes[1:4]]
        if others:
            lines.append(f"  less likely:   {', '.join(others)}")
        lines += [f"  missing:       {each}" for each in self.missing]
        if picture and self.curves:
            lines += ["", *self._characters()]
        return "\n".join(lines)

    def _characters(self) -> list[str]:
        """Return the curve with the largest values of each quantity as characters."""
        lines = []
        for each in self.curves:
            sizes = [max((abs(value) for value in curve if math.isfinite(value)), default=0.0) for curve in each.values]
            number = sizes.index(max(sizes))
            curve, most = _thinned(each.values[number], _WIDTH), sizes[number]
            bars = "".join(
                _BARS[round((len(_BARS) - 1) * min(abs(value) / most, 1.0))] if most and math.isfinite(value) else " "
                for value in curve
            )
            limit = "" if each.limit is None else f", limit {each.limit:.3g}"
            lines.append(f"|{each.name}| of {each.labels[number]}, largest {most:.3g} {each.unit}{limit}")
            lines.append(f"  {bars}")
        if self.curves:
            first, last = self.curves[0].time[0], self.curves[0].time[-1]
            lines.append(f"  from {first:.2f} s to {last:+.2f} s; the stop is at 0 s")
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Return the explanation as numbers, strings, lists and dictionaries, without the curves."""
        found = asdict(self)
        del found["curves"]
        for cause, made in zip(self.causes, found["causes"], strict=True):
            made["exceeded_by"] = cause.exceeded_by
        return found

    def svg(self) -> str:
        """Return the picture of the last second as SVG: one panel per quantity, with units, legend and the stop."""
        height = _GAP + len(self.curves) * (_HEIGHT + _GAP) + 10
        width = _LEFT + _PANEL + _LEGEND
        parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" '
            'font-family="sans-serif" font-size="11">',
            f'<rect width="{width}" height="{height}" fill="white"/>',
            f'<text x="{_LEFT}" y="18" font-size="13">{escape(str(self)[:95])}</text>',
        ]
        for number, each in enumerate(self.curves):
            parts += _panel(each, _GAP + number * (_HEIGHT + _GAP), is_last=number == len(self.curves) - 1)
        return "\n".join([*parts, "</svg>", ""])

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the picture to an .svg file.

        Raises:
            BadValue: If the path has another suffix.
            BadRecording: If the file cannot be written.
        """
        path = Path(path)
        if path.suffix.lower() != ".svg":
            raise BadValue(f"{path}: unsupported type of file; expected .svg")
        try:
            path.write_text(self.svg(), encoding="utf-8")
        except OSError as error:
            raise BadRecording(f"cannot write {path}: {error.strerror or error}") from error
        return path

    def _repr_html_(self) -> str:
        return f"<pre>{escape(self.text(picture=False))}</pre>{self.svg() if self.curves else ''}"


def _panel(curves: StopCurves, top: float, *, is_last: bool) -> list[str]:
    """Return the elements of one panel, whose upper edge is at `top` pixels."""
    numbers = [value for curve in curves.values for value in curve if math.isfinite(value)]
    if curves.limit is not None:
        numbers += [curves.limit]
    low, high = min(numbers, default=0.0), max(numbers, default=0.0)
    if curves.limit is not None and low < 0.0 and -curves.limit < low * 0.5:
        low = min(low, -curves.limit)
    low, high = (low - 1.0, high + 1.0) if low == high else (low, high)
    first, last = curves.time[0], max(curves.time[-1], 0.0)
    span = (last - first) or 1.0

    def x(time: float) -> float:
        return _LEFT + _PANEL * (time - first) / span

    def y(value: float) -> float:
        return top + _HEIGHT * (high - value) / (high - low)

    parts = [
        f'<text x="{_LEFT}" y="{top - 5}">{escape(curves.name)} [{escape(curves.unit)}]</text>',
        f'<rect x="{_LEFT}" y="{top}" width="{_PANEL}" height="{_HEIGHT}" fill="none" stroke="#888"/>',
    ]
    for value in (low, 0.5 * (low + high), high):
        parts.append(f'<text x="{_LEFT - 5}" y="{y(value) + 4:.1f}" text-anchor="end">{value:.3g}</text>')
    for limit in () if curves.limit is None else (curves.limit, -curves.limit):
        if low <= limit <= high:
            parts.append(
                f'<line x1="{_LEFT}" x2="{_LEFT + _PANEL}" y1="{y(limit):.1f}" y2="{y(limit):.1f}" stroke="#555" '
                'stroke-dasharray="5 4"/>'
            )
    for number, (label, curve) in enumerate(zip(curves.labels, curves.values, strict=True)):
        colour = _COLOURS[number % len(_COLOURS)]
        points = " ".join(
            f"{x(time):.1f},{y(value):.1f}"
            for time, value in zip(curves.time, curve, strict=True)
            if math.isfinite(value)
        )
        parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.3"/>')
        at = top + 10 + 17 * number
        parts.append(
            f'<line x1="{_LEFT + _PANEL + 8}" x2="{_LEFT + _PANEL + 26}" y1="{at}" y2="{at}" stroke="{colour}"/>'
        )
        parts.append(f'<text x="{_LEFT + _PANEL + 31}" y="{at + 4}">{escape(label)}</text>')
    parts.append(f'<line x1="{x(0.0):.1f}" x2="{x(0.0):.1f}" y1="{top}" y2="{top + _HEIGHT}" stroke="red"/>')
    for time in (first, 0.5 * first, 0.0):
        parts.append(f'<text x="{x(time):.1f}" y="{top + _HEIGHT + 13}" text-anchor="middle">{time:.2f}</text>')
    if is_last:
        parts.append(f'<text x="{_LEFT + _PANEL + 8}" y="{top + _HEIGHT + 13}">s; the stop is at 0</text>')
    return parts


def _thinned(values: Sequence[float], most: int) -> list[float]:
    """Return at most `most` values: the largest one, by size, of each section."""
    if len(values) <= most:
        return list(values)
    edges = [round(number * len(values) / most) for number in range(most + 1)]
    return [max(values[begin:end], key=abs) for begin, end in itertools.pairwise(edges)]
