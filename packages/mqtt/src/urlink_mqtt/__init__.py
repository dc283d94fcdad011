"""Universal Robots arms over MQTT: a `Server` tells a broker how a robot is, and takes commands from it.

Everything is JSON. Topics, below ``urlink/NAME``:

====================  ==================================================================================
topic                 what it is
====================  ==================================================================================
``info``              retained: model, firmware, commands
``status``            retained, some times a second; its last will says that nobody serves the robot
``motion``            a motion has begun, or is over, and how
``answer``            to each command: which it was, and the error if there is one
``command/COMMAND``   subscribed to: the command of a client
``client/ID``         subscribed to: retained by a client that is there, empty when it is gone
====================  ==================================================================================
"""

from __future__ import annotations

# Before urlink, so that a warning about another distribution of that name comes before an import fails.
import linkcore  # noqa: F401

from .server import Broker, Server

__all__ = ["Broker", "Server"]
