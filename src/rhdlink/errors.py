"""The errors of a robot, beside those of any peer.

Branches of the tree in `linkcore.errors`::

    LinkError
    ├── LocalError
    │   └── NotThere            an optional variable that this robot lacks        (AttributeError)
    └── RemoteError
        ├── AccessDenied        the robot has a master already                    (PermissionError)
        └── WrongVariables      the robot's variables are not those declared
"""

from __future__ import annotations

from collections.abc import Sequence

from linkcore.errors import LocalError, RemoteError

__all__ = ["AccessDenied", "NotThere", "WrongVariables"]


class NotThere(LocalError, AttributeError):
    """An optional variable that this robot lacks, or a name that it does not know."""


class AccessDenied(RemoteError, PermissionError):
    """Write access was refused, or a variable was set without it."""


class WrongVariables(RemoteError):
    """The robot lacks variables that were declared, or has them in another length or direction.

    Attributes:
        differences: one sentence for each.
    """

    def __init__(self, differences: Sequence[str]) -> None:
        self.differences = tuple(differences)
        super().__init__("the robot's variables are not those declared: " + "; ".join(self.differences))

    def __reduce__(self) -> tuple[object, ...]:
        return (type(self), (self.differences,))
