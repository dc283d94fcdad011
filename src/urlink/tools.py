"""Names for tools in separate packages, in addition to the names that every program uses.

Such a tool tests a controller, shows an arm, or imitates the API of another client. For this, the tool needs protocols
without a connection, the parameters of the arms, and functions for a command line. A program that moves an arm needs
nothing from this module.

The packages in the folder packages/ import only from this module, from `urlink`, and from the other public modules.
Each name here comes from an internal module of the library, so the name might change with any release. Such a change is
made here and in the packages at the same time.
"""

from __future__ import annotations

# For commands: arguments, progress, and interruption.
from linkcore.cli.options import (
    DURATION as DURATION,
    argument as argument,
    command as command,
    positive_number as positive_number,
    seconds as seconds,
)
from linkcore.cli.progress import ProgressBar as ProgressBar
from linkcore.cli.terminal import Interruption as Interruption

# For classes and text.
from linkcore.names import StrictAttributes as StrictAttributes, needs as needs

# For single requests to a controller, without a stream.
from linkcore.net.dialogue import Dialogue as Dialogue
from linkcore.net.http_client import HttpClient as HttpClient
from linkcore.net.listener import bound_socket as bound_socket, local_address as local_address
from linkcore.net.transport import TcpTransport as TcpTransport, witnessed as witnessed
from linkcore.streaming.plotting import element_names as element_names

# For recordings: their bytes, their columns, and MCAP.
from linkcore.recording.columns import PacketColumns as PacketColumns
from linkcore.recording.file import (
    Kind as Kind,
    Progress as Progress,
    RecordingFile as RecordingFile,
    described as described,
    new_file as new_file,
    unseen as unseen,
)
from linkcore.recording.mcap_file import McapFile as McapFile, Topic as Topic
from linkcore.recording.packets import states_of as states_of
from linkcore.recording.text_table import read_text_table as read_text_table
from linkcore.streaming.peer_clock import lowest_edge as lowest_edge
from linkcore.text import printable as printable, similar as similar, strict_json as strict_json
from linkcore.threads import Closing as Closing, ReentrantEvent as ReentrantEvent, started as started
from linkcore.wire.cycles import gaps_of as gaps_of

# For arms: their files, their parameters, and computations with them.
from .arm import rigid as rigid
from .arm.arm_file import (
    MOTORS as MOTORS,
    ArmFile as ArmFile,
    Estimate as Estimate,
    read_arm_file as read_arm_file,
)
from .arm.dynamics import GRAVITY as GRAVITY, Dynamics as Dynamics
from .arm.kinematics.geometry import ArmLink as ArmLink, Geometry as Geometry, angles as angles, chain as chain
from .arm.motors import (
    FULL_SPEED as FULL_SPEED,
    force_size as force_size,
    joint_sizes as joint_sizes,
    motors_of as motors_of,
)
from .arm.payload import cross_matrices as cross_matrices
from .arm.parameters import Parameter as Parameter, number as number, numbers as numbers, parameters as parameters
from .arm.rigid import FLOATS as FLOATS, ROWS as ROWS
from .arm.vectors import JOINTS as JOINTS, FloatArray as FloatArray, six as six

# For commands that connect to a robot.
from .cli.monitor import with_motion as with_motion
from .cli.options import (
    ADDRESS as ADDRESS,
    LIMITS as LIMITS,
    address as address,
    agrees as agrees,
    connected as connected,
    tell as tell,
)

# For motions.
from .motion.motions import LinkName as LinkName
from .motion.moves.path import shown_tcp as shown_tcp
from .motion.servo import jog as _jog
from .motion.servo.block_motion import BlockMotion as BlockMotion
from .motion.servo.jog import FrameName as FrameName

# For the bytes of each interface.
from .protocol.dashboard.commands import COMMANDS as COMMANDS
from .protocol.dashboard.protocol import (
    DashboardProtocol as DashboardProtocol,
    parse_robot_mode as parse_robot_mode,
    parse_safety_mode as parse_safety_mode,
    parse_truth as parse_truth,
)
from .protocol.dashboard.robot_api import RobotApi as RobotApi, find as find
from .protocol.enums import SafetyStatusBits as SafetyStatusBits
from .protocol.firmware import RELEASES as RELEASES, Release as Release, release_of as release_of
from .protocol.primary.protocol import PrimaryProtocol as PrimaryProtocol
from .protocol.primary.robot_message import NO_TIMESTAMP as NO_TIMESTAMP
from .protocol.primary.robot_state import tool_offset as tool_offset
from .protocol.realtime.protocol import RealtimeProtocol as RealtimeProtocol
from .protocol.rtde.packets import (
    ControllerVersionReply as ControllerVersionReply,
    OutputsRequest as OutputsRequest,
    StartReply as StartReply,
    decode_request as decode_request,
    split_names as split_names,
)
from .protocol.rtde.protocol import Requests as Requests, RtdeProtocol as RtdeProtocol
from .recording.robot_state_table import RobotStates as RobotStates
from .recording.ros_messages import (
    description_topic as description_topic,
    log_topic as log_topic,
    topics_of as topics_of,
)
from .robot import simulated as simulated

# For URScript text.
from .script import text as text

# For addresses, and the identity of a robot.
from .session.address import (
    RecordingAddress as RecordingAddress,
    RobotAddress as RobotAddress,
    SimulatorAddress as SimulatorAddress,
    parse_address as parse_address,
)
from .session.identity import Identity as Identity, described_identity as described_identity

#: Full speed of a jog. The word JOG distinguishes the name from `FULL_SPEED` of the motors.
FULL_JOG_SPEED = _jog.FULL_SPEED
