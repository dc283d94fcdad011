"""Class `Plugin`, a part of a robot that declares variables and updates them at each tick."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Sequence
from typing import Any, Protocol

from linkcore.errors import BadValue

from ..variables.database import Database
from ..variables.declarations import Declaration, Declarations, bind, create_variables, refuse_hiding
from .config import Element

#: Methods that a host calls.
_CALLED = ("init", "periodic", "terminate")
#: Similarity, 0 to 1, above which the name of a method counts as a misspelling of a method of `Plugin`.
_MISSPELT = 0.75


class PluginHost(Protocol):
    """Interface of the object that runs a plugin: a `Host`, or a mission that runs plugins without a host."""

    @property
    def database(self) -> Database:
        """Variables of all plugins."""

    @property
    def period(self) -> float:
        """Time from one tick to the next, in s."""

    @property
    def tick(self) -> int:
        """Number of the tick, as clients receive it."""

    @property
    def writers(self) -> int:
        """Number of clients that may write; 0 if the robot has lost its master."""

    @property
    def plugins(self) -> Sequence[Plugin]:
        """Plugins that the object runs, in the order of initialisation."""

    def stop(self) -> object:
        """End properly, after the current tick."""


class Plugin(Declarations):
    """Part of a robot. To define a plugin, derive a class::

        class Battery(Plugin):
            battcapacity = Read(Int32, unit="mAh")
            calibratebattery = Write(Int32)

            def periodic(self, tick: int) -> None:
                self.battcapacity = measured()
                if self.is_updated(Battery.calibratebattery):
                    calibrate()

    The variables are declared as in a client program, from the view of the client: the plugin sets `Read` variables and
    reads `Write` variables. If another plugin has already created a variable, both plugins share it.

    The host calls the three methods below in its own thread, one plugin after the other, and only they may use the
    variables. Each call delays the tick, so long tasks need a separate thread of the plugin. A plugin must have the
    method `periodic`, even if it does nothing; the other two methods are optional.

    Attributes:
        name: Name used in messages; by default the class name in lower case, or in a file the name of the element.
        is_critical: Whether the host ends, properly, when the plugin raises an exception. Otherwise the host continues
            without the plugin.
        safety: Rank, or 0. Plugins with a rank are initialised last. They also run last, the highest rank at the very
            end, so that they can override the values that other plugins have set.
        host: Host that runs the plugin, available in `init` and later.
    """

    name: str = ""
    is_critical: bool = True
    safety: int = 0
    host: PluginHost

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        refuse_hiding(cls, Plugin)

    def init(self, config: Element) -> None:
        """Begin: open devices, and set first values.

        Only in this method can the plugin create more variables in `host.database`.

        Args:
            config: Element of the plugin in `rhdconfig.xml`; an empty element if there is no file.
        """

    def periodic(self, tick: int) -> None:
        """Read the variables that programs have written, and set the variables that programs read.

        Args:
            tick: Number of the last tick that was sent to clients; 0 in the first call.
        """

    def terminate(self) -> None:
        """End: stop the motors, and close devices.

        It is called once for each plugin whose `init` has returned, in the reverse order.
        """

    def is_updated(self, declaration: Declaration[Any, Any]) -> bool:
        """Whether a program has written the variable since the last `periodic`, even with the same value.

        Args:
            declaration: Declaration of this class: ``self.is_updated(Battery.calibratebattery)``.

        Raises:
            NotThere: If the variable is optional and does not exist.
        """
        table, identity = self._place(declaration)
        return bool(table.updated[identity])


def initialise(plugin: Plugin, host: PluginHost, config: Element | None = None) -> None:
    """Create the variables of a plugin in the database of its host, and call `init`.

    Args:
        plugin: Plugin; it gets its default name if it has none.
        host: Object that runs the plugin.
        config: Element of the plugin in a configuration; None for an empty element.
    """
    plugin.name = plugin.name or type(plugin).__name__.lower()
    plugin.host = host
    create_variables(type(plugin), host.database)
    bind(plugin, host.database)
    plugin.init(Element(plugin.name) if config is None else config)


def check_methods(plugin: Plugin) -> None:
    """Check that a host will call the methods of a plugin.

    Raises:
        BadValue: If the plugin has no `periodic`, or if it has a method whose name is a misspelt name of a method that
            a host calls.
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
