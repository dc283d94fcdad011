"""Resources that a process uses over time, and the check that they do not grow."""

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
    #: time since the start, in s
    at: float
    #: resident memory, in MB
    memory: float
    #: number of open descriptors
    descriptors: float
    #: number of threads, including threads of C libraries
    threads: float
    #: number of containers that the garbage collector tracks
    objects: float
    #: number of memory blocks that Python's allocator has in use; resident memory also includes free blocks that were
    #: not returned to the system
    blocks: float


def sample(at: float) -> Sample:
    """Measure this process. Garbage is collected first, so that only reachable objects count."""
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


#: Allowed growth of a gauge after the warm-up: as a share of its median, and as a minimum. Smaller growth is noise,
#: because memory is returned in pieces, and a connection that is just being made counts.
SHARE = {"memory": 0.03, "descriptors": 0.02, "threads": 0.02, "objects": 0.01, "blocks": 0.01}
LEAST = {"memory": 2.0, "descriptors": 1.0, "threads": 1.0, "objects": 500.0, "blocks": 2000.0}


class Trend(NamedTuple):
    gauge: str
    median: float
    #: growth from the end of the warm-up to the end of the run, according to the fitted slope
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
    """Return the median slope between all pairs of points (Theil-Sen), which ignores single outliers."""
    return statistics.median((y2 - y1) / (x2 - x1) for (x1, y1), (x2, y2) in combinations(points, 2) if x1 != x2)


def trends(samples: Sequence[Sample], warm_up: float = 0.25) -> list[Trend]:
    """Return the trend of each gauge, without the first part of the run, in which caches and pools grow."""
    kept = [each for each in samples if each.at >= samples[-1].at * warm_up]
    duration = kept[-1].at - kept[0].at
    found = []
    for gauge in SHARE:
        values = [(each.at, float(getattr(each, gauge))) for each in kept]
        median = statistics.median(value for _, value in values)
        growth = slope(values) * duration
        found.append(Trend(gauge, median, growth, max(SHARE[gauge] * median, LEAST[gauge])))
    return found
