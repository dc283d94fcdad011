"""Checks of the steps with a person, and of steps that measure times: signals, forces, stops, latency, reconnects."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from urlink import PacketError, RealtimeState
from urlink.packets import RobotMode, RobotState, SafetyMode
from urlink.rtde import Outputs
from urlink.tools import GRAVITY, PrimaryProtocol, RealtimeProtocol, parse_robot_mode, parse_safety_mode, parse_truth

from .evidence import Came, Evidence, decoded
from .obedience import outcome, span
from .person import WEIGHT
from .requirements import Check, Measured, NotTried, counted, how_different
from .standing import PAUSE

#: Time in s within which every interface must show a signal: the period of two robot states.
_SHOWN = 0.25


def _is_stopped(mode: Any) -> bool:
    return mode not in (SafetyMode.NORMAL, SafetyMode.REDUCED)


def _columns(
    evidence: Evidence, field: str, rtde: str, package: str
) -> Iterator[tuple[str, Came, Callable[[Any], Any]]]:
    """Yield each interface that reports a quantity, with its packets and a function that reads the quantity."""
    readers: dict[str, Callable[[Any], Any]] = {
        "realtime": lambda state: getattr(state, field, None),
        "rtde": lambda state: getattr(state, rtde, None),
        "primary": lambda state: getattr(getattr(state, package), field, None),
        "secondary": lambda state: getattr(getattr(state, package), field, None),
    }
    for name, read in readers.items():
        packets: Came = getattr(evidence, name)
        if packets.states and read(packets.states[-1]) is not None:
            yield name, packets, read


def _last(packets: Came, read: Callable[[Any], Any], at: float) -> Any:
    """Return the last value that arrived before the time `at`; None if there is none."""
    states = packets.between(-math.inf, at).states
    return read(states[-1]) if states else None


def _outputs(evidence: Evidence) -> Measured:
    outcome(evidence, "outputs")
    wrong, tried = [], set()
    for at, _, said in evidence.said("outputs"):
        if said.get("event") != "set":
            continue
        for name, packets, read in _columns(
            evidence, "digital_output_bits", "actual_digital_output_bits", "masterboard_data"
        ):
            tried.add(name)
            bits = _last(packets, read, at)
            if bits is not None and bool(int(bits) >> said["number"] & 1) != said["on"]:
                state = "on" if said["on"] else "off"
                wrong.append(f"{name} digital_output_bits: output {said['number']} is not {state} after it was set")
    return counted(wrong, f"each output switched, as shown by {', '.join(sorted(tried))}")


def _inputs(evidence: Evidence) -> Measured:
    outcome(evidence, "inputs")
    notes, wrong, tried = evidence.said("inputs"), [], set()
    presses = [note for note in notes if note.said.get("event") == "press"]
    for press in presses:
        end = next(n.at for n in notes if n.said.get("event") == "pressed" and n.at > press.at)
        for name, packets, read in _columns(
            evidence, "digital_input_bits", "actual_digital_input_bits", "masterboard_data"
        ):
            tried.add(name)
            values = [int(read(state)) for state in packets.between(press.at, end).states]
            changed = 0
            for before, after in itertools.pairwise(values):
                changed |= before ^ after
            if changed != 1 << press.said["number"]:
                seen = ", ".join(str(bit) for bit in range(18) if changed >> bit & 1) or "none"
                wrong.append(f"{name} digital_input_bits: input {press.said['number']} was switched; changed: {seen}")
    return counted(wrong, f"each input changed exactly its bit, as shown by {', '.join(sorted(tried))}")


def _weight(evidence: Evidence) -> Measured:
    outcome(evidence, "weight")
    at = {note.said["event"]: note.at for note in evidence.said("weight")}
    begin = span(evidence, "weight")[0]
    worst, seen = 0.0, []
    wanted = np.array([0.0, 0.0, -GRAVITY * WEIGHT])
    for name, packets, read in _columns(evidence, "tcp_force", "actual_TCP_force", "force_mode_data"):
        if name not in ("realtime", "rtde"):
            continue
        before = packets.between(begin, at["told"]).column(read)
        after = packets.between(0.5 * (at["hangs"] + at["hung"]), at["hung"]).column(read)
        if before is None or after is None:
            continue
        wrench = after.mean(axis=0) - before.mean(axis=0)
        change = wrench[:3]
        worst = max(worst, float(np.linalg.norm(change - wanted)) / (GRAVITY * WEIGHT))
        how = ""
        if np.linalg.norm(change - wanted) > 0.5 * GRAVITY * WEIGHT:
            moved = np.flatnonzero(np.abs(wrench - wanted[2]) < 0.2 * GRAVITY * WEIGHT)
            how = f": {how_different(wanted, change)}"
            if not np.ptp(after, axis=0).any():
                how = ": it is frozen"
            elif moved.size:
                how = f": its components are in another order: component {moved[0] + 1} has the weight instead of 3"
        seen.append(f"{name} tcp_force changed by {np.round(change, 1).tolist()} N{how}")
    if not seen:
        raise NotTried("this firmware does not report a force")
    return Measured(worst, f"{'; '.join(seen)}; expected {np.round(wanted, 1).tolist()} N in the base frame")


def _shown(step: str) -> Check:
    def check(evidence: Evidence) -> Measured:
        outcome(evidence, step)
        notes = {note.said["event"]: note.at for note in evidence.said(step)}
        if "asked" not in notes or evidence.firmware is None:
            raise NotTried("the step was interrupted")
        begin, end = notes["asks"], notes["asked"]
        is_stop = step == "stop-at-rest"
        wrong, tried = [], []
        field, package = ("safety_mode", "masterboard_data") if is_stop else ("robot_mode", "robot_mode_data")
        for name, packets, read in _columns(evidence, field, field, package):
            modes = [read(state) for state in packets.between(begin, end).states]
            if not modes:
                continue
            tried.append(f"{name} {field}")
            good = [_is_stopped(int(m)) if is_stop else int(m) < RobotMode.RUNNING for m in modes]
            if not all(good):
                wrong.append(f"{name} {field} is {modes[good.index(False)]} during the {_DURING[step]}")
        for name in ("primary", "secondary"):
            for state in getattr(evidence, name).between(begin, end).states:
                mode = state.robot_mode_data
                flag = mode.is_protective_stopped if is_stop else not mode.is_power_on
                if not flag:
                    flag_name = "is_protective_stopped is off" if is_stop else "is_power_on is on"
                    wrong.append(f"{name} {flag_name} during the {_DURING[step]}")
                    break
        answers = {note.said["asked"]: note.said for note in evidence.said(step) if note.said["event"] == "answer"}
        for asked, said in answers.items():
            try:
                if asked == "safetymode" and is_stop:
                    is_right = _is_stopped(parse_safety_mode(asked, said["reply"]))
                elif asked == "robotmode" and not is_stop:
                    is_right = int(parse_robot_mode(said["reply"], evidence.firmware.is_cb2)) < RobotMode.RUNNING
                elif asked == "running" and not is_stop:
                    is_right = not parse_truth(asked, said["reply"])
                else:
                    continue
            except PacketError:
                continue  # another requirement reports this error
            tried.append(f"dashboard {asked}")
            if not is_right and not said["problem"]:
                wrong.append(f"dashboard {asked} answers {said['reply']!r} during the {_DURING[step]}")
        return counted(wrong, f"shown by {', '.join(tried)}")

    return check


_DURING = {"stop-at-rest": "protective stop", "power-off": "time with the power off"}


def _latency(evidence: Evidence) -> Measured:
    said = outcome(evidence, "latency")
    if said.get("error"):
        return Measured(math.inf, said["error"])
    delays = said["delays"]
    if len(delays) < said["tried"]:
        return Measured(math.inf, f"{said['tried'] - len(delays)} of {said['tried']} messages of programs were lost")
    return Measured(min(delays), f"{min(delays) * 1e3:.0f} to {max(delays) * 1e3:.0f} ms until a program acts")


def _reconnect(evidence: Evidence) -> Measured:
    said = outcome(evidence, "reconnect")
    if said.get("error"):
        return Measured(math.inf, said["error"])
    begin, end = span(evidence, "reconnect")
    worst, seen = 0.0, []
    kinds: dict[str, tuple[Any, type, Callable[[Any], float]]] = {
        "realtime": (RealtimeProtocol, RealtimeState, lambda s: s.time),
        "primary": (PrimaryProtocol, RobotState, lambda s: s.robot_mode_data.timestamp / 1e6),
        "secondary": (PrimaryProtocol, RobotState, lambda s: s.robot_mode_data.timestamp / 1e6),
        "rtde": (None, Outputs, lambda s: s.timestamp),
    }
    for name, (protocol, kind, time) in kinds.items():
        if evidence.firmware is not None and evidence.firmware.is_cb2 and name in ("primary", "secondary"):
            continue
        there = [w for w in evidence.received(name) if w.chunks and begin <= w.chunks[0][0].monotonic <= end]
        read = [decoded(evidence, wire, protocol, kind) for wire in there]
        read = [each for each in read if each.states]
        for one, other in itertools.pairwise(read):
            first, last = time(other.states[0]), time(one.states[-1])
            passed = other.arrivals[0] - one.arrivals[-1]
            stale = min(passed, PAUSE) - (first - last)
            worst = max(worst, stale)
            seen.append(f"{name} {(first - last):+.2f} s after a pause of {passed:.2f} s")
    if not seen:
        raise NotTried("no interface sent a state with a time on both connections")
    return Measured(worst, f"first state of the next connection: {', '.join(seen)}")


def _connects_back(evidence: Evidence) -> Measured:
    said = outcome(evidence, "connects-back")
    if error := said.get("error"):
        return Measured(1.0, f"{error}. Use --reverse-host and --reverse-peer")
    return Measured(0.0, "a program on the robot connected to this computer")


REACTIONS: Mapping[str, Check] = {
    "latency": _latency,
    "reconnect": _reconnect,
    "connects-back": _connects_back,
    "outputs": _outputs,
    "inputs": _inputs,
    "weight": _weight,
    "stop-at-rest": _shown("stop-at-rest"),
    "power-off": _shown("power-off"),
}
