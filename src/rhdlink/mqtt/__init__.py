"""DTU's mobile robots of today, which use MQTT: their topics as variables, their commands, and a simulated robot.

A program on the robot's Raspberry Pi publishes the measurements of the robot, and obeys one master. `rhdlink.connect`
presents such a robot as the variables of `RobobotVariables`. Most programs need only its address, such as
``"mqtt://192.168.0.55"``.

MQTT needs paho-mqtt (``pip install urlink-robot[mqtt]``), which is imported when a connection to a broker begins.
"""

from .commands import DIALECTS, Command, Dialect
from .plugin import MqttRobot
from .simulated import SimulatedRobobot
from .topics import TOPICS, Message, Topic, decode
from .variables import RobobotVariables

__all__ = [
    "DIALECTS",
    "TOPICS",
    "Command",
    "Dialect",
    "Message",
    "MqttRobot",
    "RobobotVariables",
    "SimulatedRobobot",
    "Topic",
    "decode",
]
