from __future__ import annotations

from tests.mutants.equivalent import Equivalent

EQUIVALENT: tuple[Equivalent, ...] = (
    Equivalent(
        "rhdlink/host/config.py",
        "read_file",
        "1",
        "2",
        "one byte beyond the largest file already shows that the file is too large",
    ),
)
