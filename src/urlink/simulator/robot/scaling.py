"""Speed scaling of programs: its parameters, each with what backs it.

The facts and their sources: docs/protocols/urscript.md, Speed scaling.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

from linkcore.arguments import check_number

__all__ = ["Evidence", "ScalingParameters", "approached"]

#: What backs a value: the log of a real arm, the vendor's documents, an inference from these, or a guess.
Evidence = Literal["log", "vendor", "inferred", "guess"]


def _backed(default: Any, unit: str, evidence: Evidence, source: str) -> Any:
    return dataclasses.field(default=default, metadata={"unit": unit, "evidence": evidence, "source": source})


@dataclasses.dataclass(frozen=True, kw_only=True)
class ScalingParameters:
    """How a controller scales the motion of programs. The metadata of each field hold its unit, evidence and source.

    Attributes:
        start_rate: 1/s, with which the scaling rises from 0 at the start of a program.
        slider_rate: 1/s, with which it follows the speed slider.
        resume_rate: 1/s, with which it rises from 0 when a program is resumed.
        servoj_lag_stretches: whether the lag of ``servoj`` lasts longer by 1 / scaling, as all motion does. If not,
            only the time of the set-points is stretched, and the arm goes on to the last one while the scaling is 0.

    Raises:
        BadValue: a rate is not above zero.
    """

    start_rate: float = _backed(6.25, "1/s", "log", "17 moves of a UR3e: 0 to 1 in 160 ms, linear")
    slider_rate: float = _backed(6.25, "1/s", "inferred", "as at the start of a program")
    resume_rate: float = _backed(6.25, "1/s", "inferred", "as at the start of a program")
    servoj_lag_stretches: bool = _backed(True, "", "guess", "the scaling slows down all joints")

    def __post_init__(self) -> None:
        for name in ("start_rate", "slider_rate", "resume_rate"):
            check_number(getattr(self, name), name, 1e-3, 1e6, "1/s")


def approached(now: float, target: float, most: float) -> float:
    """A number that has come closer to `target`, by at most `most`."""
    return target if abs(target - now) <= most else now + most if target > now else now - most
