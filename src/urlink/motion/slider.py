"""Effect of the speed slider on each motion, as the class of the motion declares it.

docs/speed-scaling.md shows `EFFECTS` as a table, and a test measures each row on the simulated controller.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import TypeVar

C = TypeVar("C", bound=type)


class SliderEffect(enum.Enum):
    """Speed of the arm with the slider at 50 %, and at 0, as fractions of the speed with the slider at 100 %."""

    SCALED = (0.5, 0.0)
    #: its times are on the clock of this computer or of the controller, but at 0 the program does not move the arm
    KEPT_UNTIL_0 = (1.0, 0.0)
    #: the arm is moved by forces or torques instead of the set-points of a program
    UNSCALED = (1.0, 1.0)

    @property
    def half(self) -> float:
        """Fraction with the slider at 50 %."""
        return self.value[0]

    @property
    def zero(self) -> float:
        """Fraction with the slider at 0."""
        return self.value[1]


#: motion, as users call it -> the class that declares the effect, and the effect
EFFECTS: dict[str, tuple[type, SliderEffect]] = {}


def slider(**effects: SliderEffect) -> Callable[[C], C]:
    """Declare the effect of the slider on the motions of a class.

    Args:
        effects: Effect on each motion, by the name of the method that starts it.
    """
    return slider_by_use(effects)


def slider_by_use(effects: dict[str, SliderEffect]) -> Callable[[C], C]:
    """Do the same as `slider`, for a motion that can be used in several ways with different effects.

    Args:
        effects: Effect on each use: the name of the method, a comma, and the use.
    """

    def state(kind: C) -> C:
        EFFECTS.update({name: (kind, effect) for name, effect in effects.items()})
        return kind

    return state
