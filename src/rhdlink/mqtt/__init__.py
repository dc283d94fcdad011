"""DTU's mobile robots of today, which use MQTT: their topics as variables, their commands, and a simulated robot.

A program on the robot's Raspberry Pi publishes the measurements of the robot, and obeys one master. `rhdlink.connect`
presents such a robot as the variables of `RobobotVariables`. Most programs need only its address, such as
``"mqtt://192.168.0.55"``.

MQTT needs paho-mqtt (``pip install urlink-robot[mqtt]``), which is imported when a connection to a broker begins.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from linkcore.names import lazy_names

if TYPE_CHECKING:
    from .commands import DIALECTS as DIALECTS
    from .commands import Command as Command
    from .commands import Dialect as Dialect
    from .mqtt_robot import MqttRobot as MqttRobot
    from .simulated import SimulatedRobobot as SimulatedRobobot
    from .topics import TOPICS as TOPICS
    from .topics import Message as Message
    from .topics import Topic as Topic
    from .topics import decode as decode
    from .variables import RobobotVariables as RobobotVariables

else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            ".commands": "DIALECTS Command Dialect",
            ".mqtt_robot": "MqttRobot",
            ".simulated": "SimulatedRobobot",
            ".topics": "TOPICS Message Topic decode",
            ".variables": "RobobotVariables",
        },
    )
