"""The identity of a controller: firmware, model and calibration, from its first packets."""

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
from ..protocol.firmware import Firmware, infer, release_of
from ..protocol.ports import refusal_hint
from ..protocol.primary.protocol import PrimaryProtocol
from ..protocol.primary.robot_state import ConfigurationData, KinematicsInfo, RobotState

if TYPE_CHECKING:
    from ..arm.kinematics import Arm, DenavitHartenberg

#: How long to wait for the rest once a part is known: the first state follows within 0.1 s.
_GRACE = 1.0


@dataclass(frozen=True)
class Identity:
    """What is known of a controller.

    Attributes:
        firmware: its version; where it did not say, the oldest that sends such states.
        said_so: whether the firmware was reported by the controller.
        model: name of the arm, such as "UR5e"; None where no configuration came.
        dh_table: its Denavit-Hartenberg parameters as calibrated; None where they did not come.
    """

    firmware: Firmware
    said_so: bool
    model: str | None
    dh_table: DenavitHartenberg | None = field(default=None, compare=False, repr=False)

    @property
    def arm(self) -> Model | None:
        """Geometry and limits of the arm; None where the controller does not report its model, or it is not known."""
        return None if self.model is None else MODELS.get(self.model)

    @cached_property
    def kinematics(self) -> Arm:
        """Forward and inverse kinematics, see `Robot.kinematics`.

        Raises:
            LocalError: it is not known which arm this is.
            WrongPeer: the parameters that came are not those of such an arm.
        """
        # Imported here: it takes some 30 ms, which a program that only listens need not spend.
        from ..arm.kinematics import Arm

        arm = self.arm
        if arm is None:
            what = (
                "does not say which arm it has" if self.model is None else f"has an arm that is not known, {self.model}"
            )
            raise LocalError(f"the controller {what}; urlink.kinematics.Arm takes the name of one")
        if self.dh_table is None:
            return Arm(arm)
        try:
            return Arm.calibrated(arm, self.dh_table)
        except BadValue as error:
            raise WrongPeer(f"the controller of a {arm.name} sends unusable DH parameters: {error}") from None

    def description(self) -> dict[str, Any]:
        """The identity as a recording stores it, since the first state, which has it too, is seldom recorded.

        JSON can hold it.
        """
        said: dict[str, Any] = {"firmware": str(self.firmware), "model": self.model}
        if self.dh_table is not None:
            names = ("dh_theta", "dh_a", "dh_d", "dh_alpha")
            said["dh_table"] = {name: list(map(float, getattr(self.dh_table, name))) for name in names}
        return said


def described_identity(said: Mapping[str, Any]) -> Identity:
    """The identity that `Identity.description` has stored in a recording.

    Raises:
        BadRecording: it names no firmware, its model is not a text, or what it has under ``dh_table`` are no DH
            parameters.
        BadVersion: the firmware is not a version.
    """
    firmware, model, written = said.get("firmware"), said.get("model"), said.get("dh_table")
    if not isinstance(firmware, str):
        raise BadRecording(f"channel {said.get('name')!r} does not say what firmware it was recorded from")
    if not isinstance(model, str | None):
        raise BadRecording(f"channel {said.get('name')!r}: the model is {model!r:.80}, and no text")
    table = None
    if written is not None:
        from ..arm.kinematics import DhTable

        try:
            table = DhTable(**written)
        except TypeError as error:
            name = said.get("name")
            raise BadRecording(f"channel {name!r} has no DH parameters under dh_table: {error}") from None
    return Identity(Firmware.parse(firmware), said_so=True, model=model, dh_table=table)


class KnownIdentity:
    """The last known identity of the controller; it is asked anew after each reconnect.

    Args:
        ask: asks it.
        known: what it has answered already; None to ask now.

    Attributes:
        last: the last answer.
    """

    def __init__(self, ask: Callable[[], Identity], known: Identity | None = None) -> None:
        self._ask = ask
        self._doubts = self._answered = 0
        self.last = ask() if known is None else known

    def doubt(self) -> None:
        """It was connected to anew, and may be another one."""
        self._doubts += 1

    @property
    def identity(self) -> Identity:
        """Who it is.

        Raises:
            RemoteError: it had to be asked, and did not answer.
        """
        if (doubts := self._doubts) != self._answered:
            self.last = self._ask()
            self._answered = doubts  # one that has come up meanwhile stays
        return self.last


def identify(host: str, port: int, timeout: float) -> Identity:
    """Connect to a primary or secondary interface, read the controller's identity, and disconnect.

    Raises:
        ConnectFailed: nobody answers there.
        ConnectionLost: it closed the connection before it identified itself.
        LinkTimeout: silent, or not done within `timeout` seconds.
        WrongPeer: something else is talking.
    """
    introduction = Introduction(f"{host}:{port}", timeout)
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
    """The packets with which a controller begins a connection, sans-IO.

    Args:
        name: of the peer, for messages.
        timeout: seconds from now on.
    """

    def __init__(self, name: str, timeout: float) -> None:
        self._name = name
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
        """Seconds that are left to listen."""
        return clock.left(self._until)

    @property
    def is_over(self) -> bool:
        """Nothing more is to be expected, or time is up."""
        firmware = self._protocol.firmware
        is_told = firmware is not None and (self._configuration is not None or _says_no_more(firmware, self._state))
        return is_told or self._lost is not None or not self.left

    def receive(self, data: bytes) -> None:
        """Bytes have come."""
        self._received = (self._received + data)[:64]
        for frame in self._protocol.framer.feed(data):
            try:
                packet = self._protocol.decode(frame)
            except PacketError:
                continue  # the other packets are still of use after a bad one
            if isinstance(packet, RobotState):
                self._state = self._state or packet
                # They are in one state, the first, if they are sent at all.
                self._configuration = self._configuration or packet.configuration_data
                self._kinematics = self._kinematics or packet.kinematics_info
        if self._protocol.firmware is not None or self._state is not None:
            self._until = min(self._until, clock.now() + _GRACE)

    def lose(self, error: ConnectionLost) -> None:
        """The connection was lost: nothing more will come."""
        self._lost = unraised(error)

    @property
    def identity(self) -> Identity:
        """Who it is.

        Raises:
            ConnectionLost: it closed the connection before it sent its version.
            LinkTimeout: it has not sent its version.
            WrongPeer: it is not a controller.
        """
        protocol, state = self._protocol, self._state
        firmware = protocol.firmware or (None if state is None else infer(state.sizes))
        if firmware is not None:
            model = _model_name(self._configuration, firmware)
            return Identity(firmware, protocol.firmware is not None, model, self._kinematics)
        began = f"it began with {self._received[:32]!r}"
        if protocol.framer.skipped:
            raise WrongPeer(f"{self._name} does not talk like a UR controller; {began}")
        if state is not None:
            raise WrongPeer(
                f"{self._name} talks like a UR controller, but does not say its version, and no firmware that is known "
                f"sends such states: {dict(state.sizes)}"
            )
        if self._lost is not None:
            raise unraised(self._lost)
        if not self._received:
            raise LinkTimeout(f"{self._name} took the connection but sent nothing within {self._timeout:g} s")
        raise LinkTimeout(f"{self._name} did not say who it is within {self._timeout:g} s; {began}")


def _says_no_more(firmware: Firmware, state: RobotState | None) -> bool:
    """Before 1.8 no state has the configuration, so there is nothing to wait for."""
    try:
        return state is not None and 6 not in release_of(firmware).state
    except BadVersion:
        return False


def _model_name(configuration: ConfigurationData | None, firmware: Firmware) -> str | None:
    if configuration is None:
        return None
    model = model_of(int(configuration.robot_type), firmware.is_e_series)
    return configuration.robot_type.name if model is None else model.name
