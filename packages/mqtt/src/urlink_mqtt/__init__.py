"""Universal Robots arms over MQTT: a `Server` publishes the status of a robot, and accepts commands from a broker.

All messages are JSON. Topics, below ``urlink/NAME``:

====================  ==================================================================================
topic                 content
====================  ==================================================================================
``info``              retained: model, firmware, commands
``status``            retained, several times per second; its last will reports that the robot is not served
``motion``            start of a motion, or its end and result
``answer``            answer to each command: its client, id and name, and the error if there is one
``command/COMMAND``   subscribed to: the command of a client
``client/ID``         subscribed to: retained by a client while it is present, empty when it has left
====================  ==================================================================================
"""

from __future__ import annotations

# Before urlink: the warning about another distribution named linkcore must come before an import fails.
import linkcore  # noqa: F401

from .server import Broker, Server

__all__ = ["Broker", "Server"]
