"""What the speed slider does to each motion, as the class of the motion states it.

The table in docs/speed-scaling.md is that of `EFFECTS`, and a test measures each row on the simulated controller.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import TypeVar

C = TypeVar("C", bound=type)


class SliderEffect(enum.Enum):
    """The speed of the arm with the slider at 50 %, and at 0, as fractions of the speed with the slider at 100 %."""

    SCALED = (0.5, 0.0)
    #: its times are those of this computer or of the controller's clock, but at 0 the program moves nothing
    KEPT_UNTIL_0 = (1.0, 0.0)
    #: forces or torques move the arm, and no set-points of a program
    UNSCALED = (1.0, 1.0)

    @property
    def half(self) -> float:
        """The fraction with the slider at 50 %."""
        return self.value[0]

    @property
    def zero(self) -> float:
        """The fraction with the slider at 0."""
        return self.value[1]


#: a motion, as users call it -> the class that states the effect, and the effect
EFFECTS: dict[str, tuple[type, SliderEffect]] = {}


def slider(**effects: SliderEffect) -> Callable[[C], C]:
    """Let a class of motions state what the slider does to them.

    Args:
        effects: the effect for each motion, by the name of the method that begins it.
    """
    return slider_by_use(effects)


def slider_by_use(effects: dict[str, SliderEffect]) -> Callable[[C], C]:
    """As `slider`, for a motion on which the effect depends on how it is used.

    Args:
        effects: the effect for each use: the name of the method, a comma, and the use.
    """

    def state(kind: C) -> C:
        EFFECTS.update({name: (kind, effect) for name, effect in effects.items()})
        return kind

    return state
