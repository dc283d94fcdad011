from __future__ import annotations

from tests.mutants.equivalent import Equivalent

EQUIVALENT: tuple[Equivalent, ...] = (
    Equivalent(
        "rhdlink/host/config.py",
        "read_file",
        "1",
        "2",
        "One byte beyond the largest file says that it is too large, and a second one no more than that.",
    ),
)
