"""Enumerations and bit masks of all interfaces. Unknown values of an enumeration are kept: see `OpenInt`.

Source: docs/protocols/primary.md, section Numbers that stand for something, which combines the lists of the vendor and
of public decoders.
"""

from __future__ import annotations

from enum import IntFlag

from linkcore.wire.fields import OpenInt


class PackageType(OpenInt):
    """Type byte of a package on the primary and secondary interface."""

    DISCONNECT = -1
    MODBUS_INFO = 5
    ROBOT_STATE = 16
    ROBOT_MESSAGE = 20
    HMC_MESSAGE = 22
    SAFETY_SETUP = 23
    SAFETY_COMPLIANCE_TOLERANCES = 24
    PROGRAM_STATE = 25


class RobotMode(OpenInt):
    """Robot mode of CB3 and e-Series controllers."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING_FIRMWARE = 8


class RobotModeCB2(OpenInt):
    """Robot mode of CB2 controllers; later controllers use other numbers."""

    RUNNING = 0
    FREEDRIVE = 1
    READY = 2
    INITIALIZING = 3
    SECURITY_STOPPED = 4
    EMERGENCY_STOPPED = 5
    FATAL_ERROR = 6
    NO_POWER = 7
    NOT_CONNECTED = 8
    SHUTDOWN = 9
    SAFEGUARD_STOP = 10


class ControlMode(OpenInt):
    """Quantity that the controller regulates."""

    POSITION = 0
    TEACH = 1
    FORCE = 2
    TORQUE = 3


class JointMode(OpenInt):
    """State of one joint. On CB2, 240 was emergency stopped, 247 ADC calibration, 248 dead commutation, 251 stopped."""

    RESET = 235
    SHUTTING_DOWN = 236
    PART_D_CALIBRATION = 237
    BACKDRIVE = 238
    POWER_OFF = 239
    READY_FOR_POWER_OFF = 240
    CALIBRATION_INITIALISATION = 241
    ERROR = 242
    FREEDRIVE = 243
    SIMULATED = 244
    NOT_RESPONDING = 245
    MOTOR_INITIALISATION = 246
    BOOTING = 247
    PART_D_CALIBRATION_ERROR = 248
    BOOTLOADER = 249
    CALIBRATION = 250
    VIOLATION = 251
    FAULT = 252
    RUNNING = 253
    INITIALISATION = 254
    IDLE = 255


class ToolMode(OpenInt):
    """State of the tool."""

    RESET = 235
    SHUTTING_DOWN = 236
    POWER_OFF = 239
    NOT_RESPONDING = 245
    BOOTING = 247
    BOOTLOADER = 249
    FAULT = 252
    RUNNING = 253
    IDLE = 255


class SafetyMode(OpenInt):
    """Safety mode, and safety status with its finer numbers, 12 and higher (e-Series only)."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9
    VALIDATE_JOINT_ID = 10
    UNDEFINED = 11
    AUTOMATIC_MODE_SAFEGUARD_STOP = 12
    SYSTEM_THREE_POSITION_ENABLING_STOP = 13
    TP_THREE_POSITION_ENABLING_STOP = 14
    IMMI_EMERGENCY_STOP = 15
    IMMI_SAFEGUARD_STOP = 16
    PROFISAFE_WAITING_FOR_PARAMETERS = 17
    PROFISAFE_AUTOMATIC_MODE_SAFEGUARD_STOP = 18
    PROFISAFE_SAFEGUARD_STOP = 19
    PROFISAFE_EMERGENCY_STOP = 20
    SAFETY_API_SAFEGUARD_STOP = 22


class MasterSafetyState(OpenInt):
    """Safety state of the CB2 masterboard."""

    UNDEFINED = 0
    BOOTLOADER = 1
    FAULT = 2
    BOOTING = 3
    INITIALIZING = 4
    ROBOT_EMERGENCY_STOP = 5
    EXTERNAL_EMERGENCY_STOP = 6
    SAFEGUARD_STOP = 7
    OK = 8


class MasterOnOffState(OpenInt):
    """Power state of the CB2 masterboard."""

    OFF = 0
    TURNING_ON = 1
    ON = 2
    TURNING_OFF = 3


class ProgramState(OpenInt):
    """State of the program; the same numbers as RTDE `runtime_state`."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


class AnalogDomain(OpenInt):
    """Quantity that an analogue input or output measures or drives."""

    CURRENT = 0
    VOLTAGE = 1


class RobotType(OpenInt):
    """Size of the arm; the generation of the firmware distinguishes UR5 from UR5e."""

    UR5 = 1
    UR10 = 2
    UR3 = 3
    UR16 = 4
    UR18 = 5
    UR8_LONG = 6
    UR20 = 7
    UR30 = 8
    UR15 = 9


class ToolOutputMode(OpenInt):
    """Use of the two tool outputs."""

    DIGITAL = 0
    DUAL_PIN_POWER = 1


class ToolDigitalOutputMode(OpenInt):
    """Circuit of one digital output of the tool."""

    SINGLE = 0
    SINKING_NPN = 1
    SOURCING_PNP = 2
    PUSH_PULL = 3


class TimeScaleSource(OpenInt):
    """Cause for slowing down the arm, as RTDE reports it."""

    OTHER = -1
    PROGRAM_NOT_RUNNING = 0
    NOT_SCALED = 1
    JOINT_TORQUE_LIMIT = 2
    JOINT_ACCELERATION_LIMIT = 3
    POWER_LIMIT = 4
    MOMENTUM_LIMIT = 5
    STOPPING_TIME_LIMIT = 6
    STOPPING_DISTANCE_LIMIT = 7
    TOOL_SPEED_LIMIT = 8
    ELBOW_SPEED_LIMIT = 9
    JOINT_SPEED_LIMIT = 10
    SMOOTH_TRANSITION = 11
    SAFETY_API_STOPPING_DISTANCE = 12
    USER_WRENCH_LIMIT = 13
    EXTERNAL_AXIS_SPEED = 14
    EXTERNAL_AXIS_STOPPING = 15


class MessageType(OpenInt):
    """Sub-type byte of a robot message."""

    TEXT = 0
    PROGRAM_LABEL = 1
    POPUP = 2
    VERSION = 3
    SAFETY_MODE = 5
    ROBOT_COMM = 6
    KEY = 7
    VARIABLES = 8
    REQUEST_VALUE = 9
    RUNTIME_EXCEPTION = 10
    UNNAMED_12 = 12
    PROGRAM_THREADS = 14


class MessageSource(OpenInt):
    """Sender of a robot message. Signed on the wire; joints are 100-105, 110-115, 120-125."""

    GUI = -5
    SIMULATED_ROBOT = -4
    REALTIME_MACHINE = -3
    ROBOT_INTERFACE = -2
    CONTROLLER = 7
    RTDE = 8
    SAFETY_PROCESSOR_A = 20
    SAFETY_PROCESSOR_B = 30
    SAFETY_CONTROL_BOARD_FPGA = 40
    TOOL_FPGA = 106
    EUROMAP_FPGA = 107
    TEACH_PENDANT_FPGA = 108
    TOOL_A = 116
    EUROMAP_A = 117
    TEACH_PENDANT_B = 118
    TOOL_B = 126
    EUROMAP_B = 127


class ReportLevel(OpenInt):
    """Severity of a robot comm message; 128 and higher are for the vendor's developers."""

    DEBUG = 0
    INFO = 1
    WARNING = 2
    VIOLATION = 3
    FAULT = 4
    CRITICAL = 5
    DEVELOPER_DEBUG = 128
    DEVELOPER_INFO = 129
    DEVELOPER_WARNING = 130
    DEVELOPER_VIOLATION = 131
    DEVELOPER_FAULT = 132
    DEVELOPER_CRITICAL = 133


class ReportDataType(OpenInt):
    """Encoding of the four data bytes of a safety mode or robot comm message."""

    NONE = 0
    UNSIGNED = 1
    SIGNED = 2
    FLOAT = 3
    HEX = 4


class RequestedType(OpenInt):
    """Kind of value that a popup or request value message asks the operator for."""

    BOOLEAN = 0
    INTEGER = 1
    FLOAT = 2
    STRING = 3
    POSE = 4
    JOINT_VECTOR = 5
    WAYPOINT = 6
    EXPRESSION = 7
    NONE = 8


class DigitalBits(IntFlag):
    """Bits of the digital inputs and outputs on CB3 and e-Series; unknown bits are kept.

    On CB2, 0-7 are the inputs and outputs. Public decoders differ on whether the tool is at 8-9 or 16-17.
    """

    STANDARD_0 = 1 << 0
    STANDARD_1 = 1 << 1
    STANDARD_2 = 1 << 2
    STANDARD_3 = 1 << 3
    STANDARD_4 = 1 << 4
    STANDARD_5 = 1 << 5
    STANDARD_6 = 1 << 6
    STANDARD_7 = 1 << 7
    CONFIGURABLE_0 = 1 << 8
    CONFIGURABLE_1 = 1 << 9
    CONFIGURABLE_2 = 1 << 10
    CONFIGURABLE_3 = 1 << 11
    CONFIGURABLE_4 = 1 << 12
    CONFIGURABLE_5 = 1 << 13
    CONFIGURABLE_6 = 1 << 14
    CONFIGURABLE_7 = 1 << 15
    TOOL_0 = 1 << 16
    TOOL_1 = 1 << 17


class RobotStatusBits(IntFlag):
    """Bits of RTDE's `robot_status_bits`; unknown bits are kept."""

    POWER_ON = 1 << 0
    PROGRAM_RUNNING = 1 << 1
    TEACH_BUTTON_PRESSED = 1 << 2
    POWER_BUTTON_PRESSED = 1 << 3


class SafetyStatusBits(IntFlag):
    """Bits of RTDE's `safety_status_bits`; unknown bits are kept."""

    NORMAL_MODE = 1 << 0
    REDUCED_MODE = 1 << 1
    PROTECTIVE_STOPPED = 1 << 2
    RECOVERY_MODE = 1 << 3
    SAFEGUARD_STOPPED = 1 << 4
    SYSTEM_EMERGENCY_STOPPED = 1 << 5
    ROBOT_EMERGENCY_STOPPED = 1 << 6
    EMERGENCY_STOPPED = 1 << 7
    VIOLATION = 1 << 8
    FAULT = 1 << 9
    STOPPED_DUE_TO_SAFETY = 1 << 10
