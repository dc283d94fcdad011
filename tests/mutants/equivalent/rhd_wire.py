from __future__ import annotations

from tests.mutants.equivalent import Equivalent

EQUIVALENT: tuple[Equivalent, ...] = (
    Equivalent(
        "rhdlink/wire/data.py",
        "is_done",
        "start + self.at <= len(buffer)",
        "start + self.at < len(buffer)",
        "the end of the batch follows its last package, so the package is then checked with more bytes",
    ),
)
