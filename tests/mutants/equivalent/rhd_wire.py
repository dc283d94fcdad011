from __future__ import annotations

from tests.mutants.equivalent import Equivalent

EQUIVALENT: tuple[Equivalent, ...] = (
    Equivalent(
        "rhdlink/wire/data.py",
        "is_done",
        "start + self.at <= len(buffer)",
        "start + self.at < len(buffer)",
        "Behind the last package of a batch stands its end, so a package is looked at with more bytes then.",
    ),
)
