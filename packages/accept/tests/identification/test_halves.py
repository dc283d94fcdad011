"""The intervals hold on the log of a real UR3e."""

from __future__ import annotations

import numpy as np
import pytest

from packages.accept.tests.identification.halves import DISJOINT, WIDTH, agreement
from tests import real_captures
from urlink_accept.identification.samples import read_samples


@pytest.mark.slow
@pytest.mark.captures("real")
def test_intervals_of_the_halves_of_a_real_log_overlap() -> None:
    samples = read_samples(real_captures.folder("real") / "ur3e_rtde.csv")
    found = [agreement(samples, "UR3e", seed) for seed in range(2)]
    assert found[0].compared >= 36
    assert len(found[0].ordered) <= DISJOINT * found[0].compared, found[0].ordered
    at_random = sum(len(each.random) for each in found) / sum(each.compared_at_random for each in found)
    assert at_random <= DISJOINT
    widths = [width for each in found for width in each.widths.values()]
    assert 0.5 < np.mean(widths) <= WIDTH
