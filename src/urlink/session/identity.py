"""Identity of a controller: firmware, model and calibration, read from its first packets."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from linkcore import clock
from linkcore.errors import (
    BadRecording,
    BadValue,
    BadVersion,
    ConnectionLost,
    LinkTimeout,
    LocalError,
    PacketError,
    WrongPeer,
    unraised,
)
from linkcore.net.transport import TcpTransport

from ..arm.models import MODELS, Model, model_of
from ..protocol.firmware import FREQUENCIES, Firmware, SlowFirmware, infer, release_of
from ..protocol.ports import refusal_hint
from ..protocol.primary.protocol import PrimaryProtocol
from ..protocol.primary.robot_state import ConfigurationData, KinematicsInfo, RobotState

if TYPE_CHECKING:
    from ..arm.kinematics import Arm, DenavitHartenberg

#: Time to wait for the other parts of the identity after the first, in seconds. The first state follows within 0.1 s.
_GRACE = 1.0


@dataclass(frozen=True)
class Identity:
    """Identity of a controller.

    Attributes:
        firmware: Firmware version. If the controller did not report it, the oldest firmware that sends such states. Its
            `rate` is the number of cycles per second of this controller.
        said_so: Whether the controller reported the firmware.
        model: Name of the arm, such as "UR5e"; None if no configuration was received.
        dh_table: Calibrated Denavit-Hartenberg parameters; None if they were not received.
    """

    firmware: Firmware
    said_so: bool
    model: str | None
    dh_table: DenavitHartenberg | None = field(default=None, compare=False, repr=False)

    @property
    def arm(self) -> Model | None:
        """Geometry and limits of the arm; None if the controller does not report a model, or the model is unknown."""
        return None if self.model is None else MODELS.get(self.model)

    @cached_property
    def kinematics(self) -> Arm:
        """Forward and inverse kinematics; see `Robot.kinematics`.

        Raises:
            LocalError: If the arm is unknown.
            WrongPeer: If the received DH parameters do not belong to such an arm.
        """
        # Imported here, because the import takes about 30 ms, which a program that only reads states can save.
        from ..arm.kinematics import Arm

        arm = self.arm
        if arm is None:
            what = (
                "does not report its arm model" if self.model is None else f"reports the unknown arm model {self.model}"
            )
            raise LocalError(f"the controller {what}; create a urlink.kinematics.Arm with the name of a model instead")
        if self.dh_table is None:
            return Arm(arm)
        try:
            return Arm.calibrated(arm, self.dh_table)
        except BadValue as error:
            raise WrongPeer(f"the controller of a {arm.name} sends unusable DH parameters: {error}") from None

    def description(self) -> dict[str, Any]:
        """Return the identity as a recording stores it, as values that JSON supports.

        A recording stores the identity separately, because it rarely contains the first state, which has the identity.
        """
        said: dict[str, Any] = {"firmware": str(self.firmware), "model": self.model}
        if isinstance(self.firmware, SlowFirmware):
            said["controller_frequency"] = self.firmware.rate
        if self.dh_table is not None:
            names = ("dh_theta", "dh_a", "dh_d", "dh_alpha")
            said["dh_table"] = {name: list(map(float, getattr(self.dh_table, name))) for name in names}
        return said


def described_identity(said: Mapping[str, Any]) -> Identity:
    """Return the identity that `Identity.description` has stored in a recording.

    Raises:
        BadRecording: If the firmware is missing, the model is not a string, ``dh_table`` has no valid DH parameters, or
            no simulated controller with this firmware has the frequency.
        BadVersion: If the firmware is not a version.
    """
    firmware, model, written = said.get("firmware"), said.get("model"), said.get("dh_table")
    if not isinstance(firmware, str):
        raise BadRecording(f"channel {said.get('name')!r} does not name the firmware of the controller")
    if not isinstance(model, str | None):
        raise BadRecording(f"channel {said.get('name')!r}: the model is {model!r:.80}; expected a string")
    table = None
    if written is not None:
        from ..arm.kinematics import DhTable

        try:
            table = DhTable(**written)
        except TypeError as error:
            name = said.get("name")
            raise BadRecording(f"channel {name!r} has invalid DH parameters in dh_table: {error}") from None
    return Identity(described_firmware(said, firmware), said_so=True, model=model, dh_table=table)


def described_firmware(said: Mapping[str, Any], firmware: str) -> Firmware:
    """Return the firmware in the description of a channel, with its frequency.

    Args:
        said: Description.
        firmware: Its firmware.

    Raises:
        BadRecording: If no simulated controller with this firmware has the frequency.
        BadVersion: If the firmware is not a version.
    """
    frequency = described_frequency(said)
    try:
        return Firmware.parse(firmware) if frequency is None else Firmware.parse(firmware).at(frequency)
    except BadValue as error:
        raise BadRecording(f"channel {said.get('name')!r}: {error}") from None


def described_frequency(said: Mapping[str, Any]) -> int | None:
    """Return the frequency of a slow simulated controller in the description of a channel, in Hz; None for others.

    Raises:
        BadRecording: If no simulated controller has the frequency.
    """
    frequency = said.get("controller_frequency")
    if frequency is None or (type(frequency) is int and frequency in FREQUENCIES):
        return frequency
    one_of = ", ".join(map(str, FREQUENCIES))
    name = said.get("name")
    raise BadRecording(f"channel {name!r}: controller_frequency is {frequency!r:.80}; expected one of {one_of} Hz")


class KnownIdentity:
    """Last known identity of the controller, which is read again after each reconnect.

    Args:
        ask: Function that reads the identity from the controller.
        known: Identity that was read already; None to read it now.

    Attributes:
        last: Identity that was read last.
    """

    def __init__(self, ask: Callable[[], Identity], known: Identity | None = None) -> None:
        self._ask = ask
        # A new mark for each doubt. Counting would lose one of two reconnects that two threads record at once.
        self._doubt = self._answered = object()
        self.last = ask() if known is None else known

    def doubt(self) -> None:
        """Record a reconnect, after which the controller might be another one."""
        self._doubt = object()

    @property
    def identity(self) -> Identity:
        """Identity of the controller, which is read again after a reconnect.

        Raises:
            RemoteError: If the identity must be read, and the controller does not answer.
        """
        if (doubt := self._doubt) is not self._answered:
            self.last = self._ask()
            self._answered = doubt  # a reconnect during the call stays recorded
        return self.last


def identify(host: str, port: int, timeout: float, frequency: int | None = None) -> Identity:
    """Connect to a primary or secondary interface, read the controller's identity, and disconnect.

    Args:
        host, port: Address of the interface.
        timeout: Maximum time for each step, in seconds.
        frequency: See `Introduction`.

    Raises:
        BadValue: See `Introduction.identity`.
        ConnectFailed: If nothing listens at the address.
        ConnectionLost: If the controller closes the connection before it has identified itself.
        LinkTimeout: If the controller sends nothing, or has not identified itself within `timeout` seconds.
        WrongPeer: If the peer is not a controller.
    """
    introduction = Introduction(f"{host}:{port}", timeout, frequency)
    transport = TcpTransport(host, port, silence=min(0.1, timeout), refused=lambda: refusal_hint(None))
    transport.open(timeout)
    try:
        while not introduction.is_over:
            try:
                introduction.receive(transport.receive()[0])
            except LinkTimeout:
                continue
            except ConnectionLost as error:
                introduction.lose(error)
    finally:
        transport.close()
    return introduction.identity


class Introduction:
    """Decoder of the first packets of a connection, which contain the identity. Sans-IO.

    Args:
        name: Name of the peer, used in messages.
        timeout: Maximum time from now until the identity is known, in seconds.
        frequency: Cycles per second of a simulated controller, in Hz, which its packets do not show; None if they
            follow from the firmware.
    """

    def __init__(self, name: str, timeout: float, frequency: int | None = None) -> None:
        self._name = name
        self._frequency = frequency
        self._timeout = timeout
        self._until = clock.now() + timeout
        self._protocol = PrimaryProtocol()
        self._received = b""
        self._lost: ConnectionLost | None = None
        self._state: RobotState | None = None
        self._configuration: ConfigurationData | None = None
        self._kinematics: KinematicsInfo | None = None

    @property
    def left(self) -> float:
        """Remaining time, in seconds."""
        return clock.left(self._until)

    @property
    def is_over(self) -> bool:
        """Whether no more packets are needed, no more can arrive, or the time has expired."""
        firmware = self._protocol.firmware
        is_told = firmware is not None and (self._configuration is not None or _says_no_more(firmware, self._state))
        return is_told or self._lost is not None or not self.left

    def receive(self, data: bytes) -> None:
        """Process received bytes."""
        self._received = (self._received + data)[:64]
        for frame in self._protocol.framer.feed(data):
            try:
                packet = self._protocol.decode(frame)
            except PacketError:
                continue  # the packets after an invalid one are still useful
            if isinstance(packet, RobotState):
                self._state = self._state or packet
                # If the controller sends them, they are all in the first state.
                self._configuration = self._configuration or packet.configuration_data
                self._kinematics = self._kinematics or packet.kinematics_info
        if self._protocol.firmware is not None or self._state is not None:
            self._until = min(self._until, clock.now() + _GRACE)

    def lose(self, error: ConnectionLost) -> None:
        """Record that the connection was lost, so that no more packets will arrive."""
        self._lost = unraised(error)

    @property
    def identity(self) -> Identity:
        """Identity of the controller.

        Raises:
            BadValue: If no simulated controller with this firmware has the frequency.
            ConnectionLost: If the controller closed the connection before it sent its version.
            LinkTimeout: If the controller has not sent its version.
            WrongPeer: If the peer is not a controller.
        """
        protocol, state = self._protocol, self._state
        firmware = protocol.firmware or (None if state is None else infer(state.sizes))
        if firmware is not None:
            model = _model_name(self._configuration, firmware)
            firmware = firmware if self._frequency is None else firmware.at(self._frequency)
            return Identity(firmware, protocol.firmware is not None, model, self._kinematics)
        began = f"its first bytes are {self._received[:32]!r}"
        if protocol.framer.skipped:
            raise WrongPeer(f"{self._name} does not send packets of a UR controller; {began}")
        if state is not None:
            raise WrongPeer(
                f"{self._name} sends packets of a UR controller, but not its version, and no known firmware "
                f"sends such states: {dict(state.sizes)}"
            )
        if self._lost is not None:
            raise unraised(self._lost)
        if not self._received:
            raise LinkTimeout(f"{self._name} accepted the connection, but sent nothing within {self._timeout:g} s")
        raise LinkTimeout(f"{self._name} did not identify itself within {self._timeout:g} s; {began}")


def _says_no_more(firmware: Firmware, state: RobotState | None) -> bool:
    """Whether the state is complete without a configuration, which firmware before 1.8 does not send."""
    try:
        return state is not None and 6 not in release_of(firmware).state
    except BadVersion:
        return False


def _model_name(configuration: ConfigurationData | None, firmware: Firmware) -> str | None:
    if configuration is None:
        return None
    model = model_of(int(configuration.robot_type), firmware.is_e_series)
    return configuration.robot_type.name if model is None else model.name
