"""The gauges detect a leak in noise, and do not report noise as a leak."""

from __future__ import annotations

import random
import subprocess
import sys
from pathlib import Path

import pytest

from tests import platforms
from tests.soak.gauges import Sample, slope, trends


def run(leak: float, noise: float = 1.0) -> list[Sample]:
    """Return samples of 20 minutes in steps of 5 s. Each gauge grows by `leak` per hour, after a steep start."""
    chance = random.Random(1)
    samples = []
    for at in range(0, 1200, 5):
        grown = min(at, 200) / 4 + leak * at / 3600
        level = 100 + grown + chance.uniform(-noise, noise) + (40 if at % 300 == 0 else 0)
        samples.append(Sample(float(at), level, round(level), round(level), round(1000 * level), round(1000 * level)))
    return samples


def test_noise_outliers_and_steep_start_do_not_count_as_growth() -> None:
    assert all(trend.is_flat for trend in trends(run(leak=0.0)))


@pytest.mark.parametrize("leak", [30.0, 200.0])
def test_leak_counts_as_growth(leak: float) -> None:
    """A leak of 30 per hour is one object every two minutes."""
    found = trends(run(leak))
    assert not any(trend.is_flat for trend in found)
    assert found[0].growth == pytest.approx(leak / 4, rel=0.1)


def test_slope_ignores_outlier() -> None:
    assert slope([(0.0, 1.0), (1.0, 3.0), (2.0, 500.0), (3.0, 7.0), (4.0, 9.0)]) == 2.0


#: Program that prints the growth of three gauges: one descriptor, one thread, and lists that a garbage collection
#: reduces by less than a half.
GROWTH = """
import threading
from tests.soak.gauges import sample

before = sample(0.0)
end = threading.Event()
threading.Thread(target=end.wait).start()
lists = [[] for _ in range(10_000)]
with open("/dev/null"):
    after = sample(1.0)
end.set()
print(after.descriptors - before.descriptors, after.threads - before.threads, after.objects - before.objects)
"""


@platforms.needs_linux
@pytest.mark.real_time
def test_sample_counts_new_descriptor_thread_and_objects() -> None:
    # In this process, a thread of another test might end between the two samples.
    command = [sys.executable, "-c", GROWTH]
    root = Path(__file__).resolve().parents[2]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True, timeout=60.0)
    descriptors, threads, objects = map(float, done.stdout.split())
    assert (descriptors, threads) == (1.0, 1.0)
    assert objects >= 5000.0
