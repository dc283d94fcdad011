"""A movement that ends when the tool touches something."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from linkcore.handle import Lifecycle, Motion

from ..errors import NoContact
from ..urscript import yielding
from ..vectors import FloatArray, six


@dataclass(frozen=True, eq=False)
class Contact:
    """Where a contact began.

    Attributes:
        q: (6,) joint positions, rad.
        pose: (6,) of the TCP in the base frame, m and rad; None where it is not known which arm this is.
    """

    q: FloatArray
    pose: FloatArray | None


class ContactMotion(Motion):
    """A movement until a contact; made by `robot.motion.until_contact`. It fails with `NoContact` if there is none.

    Args:
        life: life cycle of the motion.
        distance: m after which it ends without a contact, for messages.
        pose_at: the pose of the TCP at joint positions.
    """

    def __init__(self, life: Lifecycle, distance: float, pose_at: Callable[[FloatArray], FloatArray | None]) -> None:
        super().__init__(life)
        self._distance = distance
        self._pose_at = pose_at
        self._contact: Contact | None = None

    @property
    def contact(self) -> Contact | None:
        """Where the contact began; None while it runs, and if it ended without a contact."""
        return self._contact

    def _on_text(self, text: str) -> None:
        """Handle a line of text from the program."""
        if text.startswith(yielding.NO_CONTACT):
            self._life.fail(NoContact(f"nothing was touched within {self._distance:g} m"))
            return
        q = yielding.contact_of(text)
        if q is not None:
            joints = six(q, "q")
            self._contact = Contact(joints, self._pose_at(joints))
