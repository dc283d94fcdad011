"""Effect of the speed slider on each motion. The class of a motion declares this effect.

docs/speed-scaling.md shows `EFFECTS` as a table. A test measures each row on the simulated controller.
"""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import TypeVar

C = TypeVar("C", bound=type)


class SliderEffect(enum.Enum):
    """Speeds of the arm with the slider at 50 % and at 0, as fractions of the speed with the slider at 100 %."""

    SCALED = (0.5, 0.0)
    #: the times of the motion are on a clock that the slider does not slow down, but at 0 the program does not move the
    #: arm
    KEPT_UNTIL_0 = (1.0, 0.0)
    #: forces or torques move the arm, instead of set-points from a program
    UNSCALED = (1.0, 1.0)

    @property
    def half(self) -> float:
        """Fraction of full speed with the slider at 50 %."""
        return self.value[0]

    @property
    def zero(self) -> float:
        """Fraction of full speed with the slider at 0."""
        return self.value[1]


#: name of a motion or of its use -> the class that declares the effect, and the effect
EFFECTS: dict[str, tuple[type, SliderEffect]] = {}


def slider(**effects: SliderEffect) -> Callable[[C], C]:
    """Declare the effect of the slider on the motions of a class.

    Args:
        effects: Effect on each motion. The key is the name of the method that starts the motion.
    """
    return slider_by_use(effects)


def slider_by_use(effects: dict[str, SliderEffect]) -> Callable[[C], C]:
    """Declare the effects of the slider on the motions of a class, if the effect depends on the use of a motion.

    Args:
        effects: Effect on each use. The key contains the name of the method, a comma, and the use.
    """

    def state(kind: C) -> C:
        EFFECTS.update({name: (kind, effect) for name, effect in effects.items()})
        return kind

    return state
