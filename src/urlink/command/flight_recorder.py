"""`FlightRecorder`: what one robot has sent and received in the last seconds, and the stops in this time."""

from __future__ import annotations

import itertools
import logging
from collections import deque
from collections.abc import Callable

from linkcore import clock
from linkcore.streaming.flight_record import FlightRecord, Received, Sent, SentRecord

from ..arm.models import MODELS
from ..diagnosis.stop_record import StopRecord, columns_of, messages_of, packets_in
from ..errors.stop_explanation import StopCause, StopExplanation
from ..protocol.enums import SafetyMode
from ..protocol.primary.protocol import PrimaryProtocol
from ..protocol.realtime.packets import RealtimeState
from ..protocol.realtime.protocol import RealtimeProtocol
from ..session.identity import Identity

_log = logging.getLogger(__name__)

#: Time after a stop until its data are kept separately, in s. By then, the controller has reported its code.
_SETTLED = 0.7
#: Time before a stop of which the data are kept, in s.
_KEPT = 2.5
#: Number of the last programs whose names are remembered.
_PROGRAMS = 256
#: Names of stops by the interlock that are not names of safety modes.
_MODES = {
    "emergency stop": SafetyMode.ROBOT_EMERGENCY_STOP,
    "external emergency stop": SafetyMode.SYSTEM_EMERGENCY_STOP,
    "fatal error": SafetyMode.FAULT,
}

_Raw = tuple[list[bytes], list[float]]


class _Data:
    """Bytes that were received and sent, not decoded yet."""

    def __init__(self, slow: _Raw, fast: _Raw, sent: list[Sent]) -> None:
        self.slow, self.fast, self.sent = slow, fast, sent


class StopFlight:
    """One stop of a robot, with the data around it.

    Args:
        recorder: Recorder of the robot.
        cause: Name of the stop.
        at: Time at which the stop was reported, in s of `linkcore.clock.now`.
    """

    def __init__(self, recorder: FlightRecorder, cause: str, at: float) -> None:
        self.cause, self.at = cause, at
        self._recorder = recorder
        self._data: _Data | None = None
        self._explanation: StopExplanation | None = None

    def keep(self) -> None:
        """Keep the data around the stop, before newer data replace them."""
        self._data = self._recorder.data(self.at - _KEPT)

    def explain(self) -> StopExplanation:
        """Return the explanation. It does not change any more when the data are kept."""
        if self._explanation is not None:
            return self._explanation
        is_final = self._data is not None
        found = self._recorder.explain_data(self._data or self._recorder.data(self.at - _KEPT), self)
        if is_final:
            self._explanation, self._data = found, None
        return found


class FlightRecorder:
    """Data of one robot from the last seconds, and its stops.

    Args:
        slow, fast: Records of the primary and of the real-time interface; None if there is no record.
        sent: Record of the sent bytes; None if there is no record.
        who: Function that returns the last known identity of the controller, without waiting.

    Attributes:
        active: Stop that is active now, or None.
        last: Last stop, which might be over; None before the first stop.
        unsettled: Stop whose data are not kept yet, because its code might still arrive; None if there is none.
    """

    def __init__(
        self,
        slow: FlightRecord | None,
        fast: FlightRecord | None,
        sent: SentRecord | None,
        who: Callable[[], Identity],
    ) -> None:
        self._slow, self._fast, self._sent, self._who = slow, fast, sent, who
        self._programs: deque[str] = deque(maxlen=_PROGRAMS)
        self.active: StopFlight | None = None
        self.last: StopFlight | None = None
        self.unsettled: StopFlight | None = None

    # -- called by the interlock and the monitor -------------------------------------------------------

    def stop(self, cause: str) -> StopFlight:
        """Return the active stop, which begins now if none is active."""
        active = self.active
        if active is None:
            active = self.active = self.last = self.unsettled = StopFlight(self, cause, clock.now())
        return active

    def end_stop(self) -> None:
        """Record that no stop is active any more."""
        self.active = None

    def settle(self, now: float) -> None:
        """Keep the data of the last stop when its code must have arrived."""
        stop = self.unsettled
        if stop is not None and now - stop.at > _SETTLED:
            stop.keep()
            self.unsettled = None

    def own(self, name: str) -> None:
        """Remember the name of a program that this client has sent."""
        self._programs.append(name)

    # -- explanations -------------------------------------------------------------------------------------

    def data(self, begin: float) -> _Data:
        """Return the data since a time, in s of `linkcore.clock.now`. Messages are returned from the whole record."""
        nothing: _Raw = ([], [])
        return _Data(
            nothing if self._slow is None else self._slow.since(float("-inf")),
            nothing if self._fast is None else self._fast.since(begin),
            [] if self._sent is None else list(self._sent.messages),
        )

    def explain(self) -> StopExplanation | None:
        """Return the explanation of the last stop, or of a program that another client stopped; None without a stop."""
        if self.last is not None:
            return self.last.explain()
        found = self._guarded(lambda: self._explained(self.data(float("-inf"))))
        return found[-1] if found else None

    def explain_data(self, data: _Data, stop: StopFlight) -> StopExplanation:
        """Return the explanation of a stop from its data."""
        found = self._guarded(lambda: [self._of_stop(data, stop)])
        if found:
            return found[-1]
        unknown = StopCause("unknown", 0.0, "The data could not be read.", remedy="Read the log on the pendant.")
        return StopExplanation(stop.cause, (unknown,), stop.at, missing=("readable data",))

    def _guarded(self, explain: Callable[[], list[StopExplanation]]) -> list[StopExplanation]:
        try:
            return explain()
        except Exception:
            # An explanation is an addition to an error. It must never replace this error by another one.
            _log.exception("a stop could not be explained")
            return []

    def _of_stop(self, data: _Data, stop: StopFlight) -> StopExplanation:
        # Imported here: a robot that never stops needs neither kinematics nor dynamics.
        from ..diagnosis.stop_causes import explain_mode, explain_stop

        record = self._record(data)
        near = [each for each in record.stops if abs(float(record.time[each.row]) - stop.at) < 1.0]
        begun = [each for each in near if not each.had_begun]
        if begun:
            return explain_stop(record, min(begun, key=lambda each: abs(float(record.time[each.row]) - stop.at)))
        name = stop.cause.removeprefix("safety mode ").replace(" ", "_").upper()
        mode = _MODES.get(stop.cause) or SafetyMode.__members__.get(name, SafetyMode.UNDEFINED)
        return explain_mode(record, mode, stop.at, had_begun=bool(near) or not len(record.time))

    def _explained(self, data: _Data) -> list[StopExplanation]:
        from ..diagnosis.stop_causes import explain

        return explain(self._record(data))

    def _record(self, data: _Data) -> StopRecord:
        fast = packets_in(itertools.starmap(_received, zip(*data.fast, strict=False)), RealtimeProtocol)
        slow = packets_in(itertools.starmap(_received, zip(*data.slow, strict=False)), PrimaryProtocol)
        time, columns = columns_of([each for each in fast if isinstance(each, RealtimeState)])
        reports, keys = messages_of(slow)
        identity = self._who()
        programs = frozenset(list(self._programs))

        def is_own(name: str) -> bool:
            return name in programs or any(name.encode() in each.data for each in data.sent)

        return StopRecord(
            time,
            columns,
            reports,
            keys,
            data.sent,
            is_own,
            None if identity.model is None else MODELS.get(identity.model),
            identity.firmware.is_cb2,
        )


def _received(data: bytes, time: float) -> Received:
    return Received(time, data)
