"""`Plugin`: a part of a robot that declares variables and updates them at each tick."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Sequence
from typing import Any, Protocol

from linkcore.errors import BadValue

from ..variables.database import Database
from ..variables.declarations import Declaration, Declarations, refuse_hiding
from .config import Element

#: Methods that a host calls.
_CALLED = ("init", "periodic", "terminate")
#: Similarity, 0 to 1, from which on the name of a method is taken for a misspelt one of `Plugin`.
_MISSPELT = 0.75


class PluginHost(Protocol):
    """What runs a plugin, as the plugin sees it: a `Host`, or a mission that runs plugins without one."""

    @property
    def database(self) -> Database:
        """The variables of all plugins."""

    @property
    def period(self) -> float:
        """Time from one tick to the next, in s."""

    @property
    def tick(self) -> int:
        """Number of the round, as clients receive it."""

    @property
    def writers(self) -> int:
        """How many clients may write: 0 when the robot has lost its master."""

    @property
    def plugins(self) -> Sequence[Plugin]:
        """The plugins that it runs, in the order in which they are initialised."""

    def stop(self) -> object:
        """End in order, after the tick that is running."""


class Plugin(Declarations):
    """A part of a robot; subclass it::

        class Battery(Plugin):
            battcapacity = Read(Int32, unit="mAh")
            calibratebattery = Write(Int32)

            def periodic(self, tick: int) -> None:
                self.battcapacity = measured()
                if self.is_updated(Battery.calibratebattery):
                    calibrate()

    The variables are declared as a program declares them, seen from there: `Read` ones are set here and `Write` ones
    read. Those that another plugin has made already are shared with it. They are for the three methods below, which the
    host calls in its own thread, one plugin after another; each call holds up the tick, so what takes long belongs in a
    thread of the plugin's own. A plugin must have `periodic`, even if that does nothing; the other two are optional.

    Attributes:
        name: for messages; by default that of the class in small letters, and in a file that of the element.
        is_critical: whether the host ends, in order, when the plugin raises, or goes on without it.
        safety: 0, or a rank. Plugins with a rank are initialised last, and run last, the highest after all others, so
            that they have the last word on what the others have set.
        host: that runs it, from `init` on.
    """

    name: str = ""
    is_critical: bool = True
    safety: int = 0
    host: PluginHost

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        refuse_hiding(cls, Plugin)

    def init(self, config: Element) -> None:
        """Begin: open devices, set first values. Further variables can be made in `host.database` here and only here.

        Args:
            config: the plugin's element of `rhdconfig.xml`; an empty one if it comes from no file.
        """

    def periodic(self, tick: int) -> None:
        """Read what the program has written, and set what it is to know.

        Args:
            tick: the number of the round that clients were sent last; 0 in the first call.
        """

    def terminate(self) -> None:
        """End: stop the motors, close devices. Called once for each plugin whose `init` returned, last one first."""

    def is_updated(self, declaration: Declaration[Any, Any]) -> bool:
        """Whether a program has written the variable, be it the same value, since the last `periodic`.

        Args:
            declaration: of this class: ``self.is_updated(Battery.calibratebattery)``.

        Raises:
            NotThere: an optional one that there is not.
        """
        table, identity = self._place(declaration)
        return bool(table.updated[identity])


def check_methods(plugin: Plugin) -> None:
    """Check that a host will call the methods of a plugin.

    Raises:
        BadValue: If the plugin has no `periodic`, or a method whose name is a misspelling of one that a host calls.
    """
    kind = type(plugin)
    own = [
        name for name, _ in inspect.getmembers(kind, inspect.isfunction) if name[0] != "_" and not hasattr(Plugin, name)
    ]
    for name in own:
        close = difflib.get_close_matches(name, _CALLED, 1, _MISSPELT)
        if close:
            raise BadValue(f"{kind.__name__} has a method {name!r}, which no host calls; did you mean {close[0]!r}?")
    if kind.periodic is Plugin.periodic:
        instead = f"; no host calls its {' and '.join(map(repr, own))}" if own else ""
        raise BadValue(
            f"{kind.__name__} has no method 'periodic', which the host calls at each tick{instead}; "
            "define periodic(self, tick)"
        )
