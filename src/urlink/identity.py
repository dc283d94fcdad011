"""Who is there: what a controller says of itself on connecting."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from linkcore.errors import BadValue, BadVersion, ConnectionLost, LinkTimeout, LocalError, PacketError, WrongPeer
from linkcore.net.transport import TcpTransport

from .firmware import Firmware, infer, release_of
from .interfaces.primary.protocol import PrimaryProtocol
from .interfaces.primary.robot_state import ConfigurationData, KinematicsInfo, RobotState
from .models import MODELS, Model, model_of
from .services import refusal_hint

if TYPE_CHECKING:
    from .kinematics import Arm, DenavitHartenberg

__all__ = ["Identity", "KnownIdentity", "identify"]

#: How long to wait for the rest once a part is known: the first state follows within 0.1 s.
_GRACE = 1.0


@dataclass(frozen=True)
class Identity:
    """What is known of a controller.

    Attributes:
        firmware: its version; where it did not say, the oldest that sends such states.
        said_so: whether the firmware is the controller's own word.
        model: name of the arm, such as "UR5e"; None where no configuration came.
        dh_table: its Denavit-Hartenberg parameters as calibrated; None where they did not come.
    """

    firmware: Firmware
    said_so: bool
    model: str | None
    dh_table: DenavitHartenberg | None = field(default=None, compare=False, repr=False)

    @property
    def arm(self) -> Model | None:
        """Geometry and limits of the arm; None where the controller does not say which it is, or nobody knows it."""
        return None if self.model is None else MODELS.get(self.model)

    @cached_property
    def kinematics(self) -> Arm:
        """Forward and inverse kinematics, see `Robot.kinematics`.

        Raises:
            LocalError: it is not known which arm this is.
            WrongPeer: the parameters that came are not those of such an arm.
        """
        # Imported here: it takes some 30 ms, which a program that only listens need not spend.
        from .kinematics import Arm

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
        """What a recording has to say of the controller, since its first state, which has this too, is seldom recorded.

        JSON can hold it.
        """
        said: dict[str, Any] = {"firmware": str(self.firmware), "model": self.model}
        if self.dh_table is not None:
            names = ("dh_theta", "dh_a", "dh_d", "dh_alpha")
            said["dh_table"] = {name: list(map(float, getattr(self.dh_table, name))) for name in names}
        return said


class KnownIdentity:
    """Who the controller was when it was asked last; it is asked anew after each reconnect.

    Args:
        ask: asks it.

    Attributes:
        last: the last answer.
    """

    def __init__(self, ask: Callable[[], Identity]) -> None:
        self._ask = ask
        self._is_stale = False
        self.last = ask()

    def doubt(self) -> None:
        """It was connected to anew, and may be another one."""
        self._is_stale = True

    @property
    def identity(self) -> Identity:
        """Who it is.

        Raises:
            RemoteError: it had to be asked, and did not answer.
        """
        if self._is_stale:
            self.last = self._ask()
            self._is_stale = False
        return self.last


def identify(host: str, port: int, timeout: float) -> Identity:
    """Connect to a primary or secondary interface, read who is there, and disconnect.

    Raises:
        ConnectFailed: nobody answers there.
        ConnectionLost: it closed the connection before it said who it is.
        LinkTimeout: silent, or not done within `timeout` seconds.
        WrongPeer: something else is talking.
    """
    until = time.monotonic() + timeout
    transport = TcpTransport(host, port, silence=min(0.1, timeout), refused=lambda: refusal_hint(None))
    transport.open(timeout)
    protocol = PrimaryProtocol()
    received = b""
    lost: ConnectionLost | None = None
    state: RobotState | None = None
    configuration: ConfigurationData | None = None
    kinematics: KinematicsInfo | None = None
    try:
        while time.monotonic() < until:
            try:
                data = transport.receive()[0]
            except LinkTimeout:
                data = b""
            except ConnectionLost as error:
                lost = error
                break
            received = (received + data)[:64]
            for frame in protocol.framer.feed(data):
                try:
                    packet = protocol.decode(frame)
                except PacketError:
                    continue  # one bad packet is no reason not to know the others
                if isinstance(packet, RobotState):
                    state = state or packet
                    # They are in one state, the first, if they are sent at all.
                    configuration = configuration or packet.configuration_data
                    kinematics = kinematics or packet.kinematics_info
            if protocol.firmware is not None and (configuration is not None or _says_no_more(protocol.firmware, state)):
                break
            if protocol.firmware is not None or state is not None:
                until = min(until, time.monotonic() + _GRACE)
    finally:
        transport.close()
    firmware = protocol.firmware or (None if state is None else infer(state.sizes))
    if firmware is None:
        if protocol.framer.skipped:
            raise WrongPeer(f"{transport.name} does not talk like a UR controller; it began with {received[:32]!r}")
        if state is not None:
            raise WrongPeer(
                f"{transport.name} talks like a UR controller, but does not say its version, and no firmware that is "
                f"known sends such states: {dict(state.sizes)}"
            )
        if lost is not None:
            raise lost
        if not received:
            raise LinkTimeout(f"{transport.name} took the connection but sent nothing within {timeout:g} s")
        raise LinkTimeout(
            f"{transport.name} did not say who it is within {timeout:g} s; it began with {received[:32]!r}"
        )
    return Identity(firmware, protocol.firmware is not None, _model_name(configuration, firmware), kinematics)


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
