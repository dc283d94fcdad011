"""What a process holds of the machine, over time, and whether it grows."""

from __future__ import annotations

import gc
import os
import statistics
import sys
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

PAGE = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096


class Sample(NamedTuple):
    #: seconds since the beginning
    at: float
    #: resident memory, MB
    memory: float
    #: open descriptors
    descriptors: float
    #: threads, those of C libraries included
    threads: float
    #: containers that the garbage collector knows
    objects: float
    #: blocks of memory that Python's allocator has handed out: what is alive, where resident memory also counts what is
    #: free and has not been given back to the system
    blocks: float


def sample(at: float) -> Sample:
    """Of this process. Garbage is collected before, so that only what is still reachable counts."""
    gc.collect()
    process = Path("/proc/self")
    pages = int((process / "statm").read_text().split()[1])
    return Sample(
        at,
        pages * PAGE / 1e6,
        len(os.listdir(process / "fd")),
        len(os.listdir(process / "task")),
        len(gc.get_objects()),
        sys.getallocatedblocks(),
    )


#: How much a gauge may grow after the warm-up: of its median, and in any case. Memory is given back in pieces, and a
#: connection that is just being made counts, so a growth below these is noise.
SHARE = {"memory": 0.03, "descriptors": 0.02, "threads": 0.02, "objects": 0.01, "blocks": 0.01}
LEAST = {"memory": 2.0, "descriptors": 1.0, "threads": 1.0, "objects": 500.0, "blocks": 2000.0}


class Trend(NamedTuple):
    gauge: str
    median: float
    #: by the fitted slope, from the end of the warm-up to the end of the run
    growth: float
    allowed: float

    @property
    def is_flat(self) -> bool:
        return self.growth <= self.allowed

    def __str__(self) -> str:
        verdict = "flat" if self.is_flat else "GROWS"
        growth = f"growth {self.growth:+9.2f}   allowed {self.allowed:8.2f}"
        return f"{self.gauge:12} median {self.median:10.1f}   {growth}   {verdict}"


def slope(points: Sequence[tuple[float, float]]) -> float:
    """The median of the slopes between all pairs of points (Theil-Sen), which single outliers do not move."""
    return statistics.median((y2 - y1) / (x2 - x1) for (x1, y1), (x2, y2) in combinations(points, 2) if x1 != x2)


def trends(samples: Sequence[Sample], warm_up: float = 0.25) -> list[Trend]:
    """One for each gauge; the first part of the run is left out, in which caches fill and pools grow."""
    kept = [each for each in samples if each.at >= samples[-1].at * warm_up]
    duration = kept[-1].at - kept[0].at
    found = []
    for gauge in SHARE:
        values = [(each.at, float(getattr(each, gauge))) for each in kept]
        median = statistics.median(value for _, value in values)
        growth = slope(values) * duration
        found.append(Trend(gauge, median, growth, max(SHARE[gauge] * median, LEAST[gauge])))
    return found
