"""Checks of received data that do not depend on its meaning: connections, bytes, sizes, rates and clocks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urlink import Firmware
from urlink.arm.models import Model
from urlink.packets import VersionMessage
from urlink.tools import RELEASES, ControllerVersionReply, Identity, Release, gaps_of, lowest_edge, release_of

from .evidence import Came, Evidence
from .requirements import Check, Measured, NotTried, counted

#: Type of the sub-package that grows with a Euromap interface, and its possible additional bytes.
_MASTERBOARD, _EUROMAP = 3, (0, 12, 16)
#: Last release of CB3. The table has no row for this release.
_LAST_CB3 = Firmware(3, 15)
#: Minimum number of packets that are needed to judge their rate.
_FEWEST = 10
#: Delay of this computer in s above which late packets are attributed to the computer itself.
_HELD_UP = 0.03
#: Relative difference of a rate above which delays of this computer are considered.
_SLOWER = 0.01
#: Uncertainty of the stamp of a packet, in s, and largest uncertainty with which a drift is judged.
_STAMPED, _MOST_DOUBT = 4e-4, 2e-3
#: Allowed delays compared with the quickest packet, in cycles: for half of the packets, and for 95 % of the packets.
_MIDDLE, _MOST = 1.5, 4.0
#: If all packets in an eighth of the time have a larger delay than this, in s, an interruption counts as the cause.
_STEP = 0.02


def known_arm(evidence: Evidence) -> tuple[Identity, Model]:
    """Return the identity of the controller, and the model of its arm.

    Raises:
        NotTried: If the controller has not reported its identity, or the arm is unknown.
    """
    known = evidence.identity
    if known is None or known.arm is None:
        raise NotTried("the arm of the controller is not known")
    return known, known.arm


def _ports(evidence: Evidence) -> Measured:
    wrong = [f"{said['name']}: {said['error']}" for _, _, said in evidence.said("port") if said["error"]]
    return counted(wrong, f"open: {', '.join(said['name'] for _, _, said in evidence.said('port'))}")


def _identity(evidence: Evidence) -> Measured:
    known = evidence.identity
    if known is None:
        return Measured(1.0, "the controller does not report its identity")
    wrong = []
    if not (evidence.last("identity") or {}).get("said_so"):
        wrong.append("no version message: the firmware is inferred from sizes")
    newest = [row.since for row in RELEASES if row.since.major <= known.firmware.major][-1]
    if known.firmware[:2] > max(newest, _LAST_CB3)[:2]:
        wrong.append(f"firmware {known.firmware} is newer than {newest}, the newest known firmware")
    if known.firmware >= (1, 8):
        if known.arm is None:
            wrong.append(f"unknown arm: {known.model}")
        if known.dh_table is None:
            wrong.append("the first state contains no calibration")
    return counted(wrong, f"{known.model}, firmware {known.firmware}, with its calibration")


def _versions(evidence: Evidence) -> Measured:
    first = evidence.firmware
    if first is None:
        raise NotTried("the controller does not report its firmware")
    said: dict[str, tuple[int, ...]] = {}
    for name in ("primary", "secondary", "rtde"):
        for _, packet in getattr(evidence, name).others:
            if isinstance(packet, (VersionMessage, ControllerVersionReply)):
                said[name] = (packet.major, packet.minor)
    for _, _, answer in evidence.said("dashboard"):
        numbers = answer["reply"].removeprefix("URSoftware ").split(".")
        if answer["asked"] in ("PolyscopeVersion", "version") and len(numbers) > 1 and numbers[1].isdigit():
            said[f"dashboard {answer['asked']}"] = (int(numbers[0]), int(numbers[1]))
    wrong = [f"{name}: {'.'.join(map(str, each))}" for name, each in said.items() if each != tuple(first[:2])]
    return counted([f"{each}, and the primary interface {first}" for each in wrong], f"{first} by {', '.join(said)}")


def _bytes(name: str) -> Check:
    def check(evidence: Evidence) -> Measured:
        packets: Came = getattr(evidence, name)
        if not evidence.received(name):
            raise NotTried(f"there was no connection to {name}")
        if not packets.sizes:
            there = sum(len(wire.data) for wire in evidence.received(name))
            return Measured(1.0, f"connected, but no packet was found in {there} B")
        wrong = list(dict.fromkeys(packets.failures))
        count = len(packets.failures) + packets.skipped
        skipped = [f"{packets.skipped} bytes belong to no packet"] if packets.skipped else []
        return Measured(float(count), counted([*wrong, *skipped], f"{sum(packets.sizes.values())} packets").seen)

    return check


def _unknown(evidence: Evidence) -> Measured:
    wrong, count = [], 0
    for name in ("primary", "secondary", "realtime", "rtde"):
        packets: Came = getattr(evidence, name)
        count += packets.unknown + packets.tails
        if packets.unknown:
            wrong.append(f"{name}: {packets.unknown} packets or parts of an unknown type")
        if packets.tails:
            wrong.append(f"{name}: {packets.tails} packets or parts with bytes at the end that no layout explains")
    return Measured(float(count), counted(wrong, "every byte is explained").seen)


def _release(evidence: Evidence) -> Release:
    if evidence.firmware is None:
        raise NotTried("the controller does not report its firmware")
    return release_of(evidence.firmware)


def _realtime_size(evidence: Evidence) -> Measured:
    release = _release(evidence)
    sizes = evidence.realtime.sizes
    if not sizes:
        raise NotTried("no packet arrived")
    worst = max(abs(size - release.realtime) for size in sizes)
    there = ", ".join(f"{count} of {size} B" for size, count in sorted(sizes.items()))
    return Measured(float(worst), f"{there}; {release.realtime} B are known for {release.since} and later")


def _state_size(evidence: Evidence) -> Measured:
    release = _release(evidence)
    known = release.state
    if not evidence.primary.states:
        raise NotTried("no robot state arrived")
    worst, wrong = 0, []
    for name in ("primary", "secondary"):
        packets: Came = getattr(evidence, name)
        seen = {(kind, size) for state in packets.states for kind, size in state.sizes.items()}
        for kind, size in sorted(seen):
            if size == known.get(kind) or (kind == _MASTERBOARD and size - known[kind] in _EUROMAP):
                continue
            worst = max(worst, abs(size - known.get(kind, 0)))
            wrong.append(f"{name}: sub-package {kind} of {size} B; known size: {known.get(kind, 'none')}")
        begins = set(packets.begins)
        later = {kind for n, state in enumerate(packets.states) if n not in begins for kind in state.sizes}
        for kind in sorted(known.keys() - release.first_state_only - later if later else ()):
            worst = max(worst, known[kind])
            wrong.append(f"{name}: no sub-package {kind}; known size: {known[kind]} B")
    return Measured(float(worst), counted(wrong, f"the sizes known for {release.since} and later").seen)


def moments(name: str, packets: Came) -> NDArray[np.float64]:
    """Return the controller's time of each state of an interface, in s, shape (n,).

    Raises:
        NotTried: If the states contain no time, or if too few states arrived.
    """
    if len(packets.states) < _FEWEST:
        raise NotTried(f"{len(packets.states)} packets of {name} arrived; {_FEWEST} are needed")
    times = packets.values(_TIMES[name]) if name in _TIMES else packets.column(_state_time)
    if times is None:
        raise NotTried(f"the packets of {name} do not contain the time of the controller")
    return times


def _state_time(state: Any) -> float | None:
    modes = state.robot_mode_data
    # On CB2, the time stamp has another meaning.
    return None if modes is None or modes.speed_scaling is None else modes.timestamp / 1e6


#: Interface -> field that contains the time of the controller in s.
_TIMES = {"realtime": "time", "rtde": "timestamp"}


def _steps(name: str, packets: Came) -> NDArray[np.float64]:
    """Return the times in s between consecutive packets of one connection."""
    times = moments(name, packets)
    steps = np.diff(times)
    return np.delete(steps, [at - 1 for at in packets.begins if at > 0])


def _listened(evidence: Evidence, name: str) -> Came:
    """Return the packets of the listening phase, in which nothing else ran and delays of the computer were noted."""
    packets: Came = getattr(evidence, name)
    return packets.between(*listening(evidence))


def listening(evidence: Evidence) -> tuple[float, float]:
    """Return the monotonic start and end times of the listening phase, in s.

    Raises:
        NotTried: If stage 0 ended before it listened.
    """
    begins = [note.at for note in evidence.said("listening")]
    if not begins:
        raise NotTried("stage 0 ended before it listened")
    ends = [note.at for note in evidence.said("woken")]
    return begins[-1], ends[-1] if ends else evidence.stage(0)[1]


def _rate(name: str) -> Check:
    def check(evidence: Evidence) -> Measured:
        if not evidence.received(name):
            raise NotTried(f"there was no connection to {name}")
        packets = _listened(evidence, name)
        rate = float(_release(evidence).since.rate)
        is_old = (evidence.last("rtde") or {}).get("protocol") == 1
        wanted = {"primary": 10.0, "rtde": 125.0 if is_old else rate}.get(name, rate)
        if name == "primary" and evidence.firmware is not None and evidence.firmware.is_cb2:
            # On CB2, the time stamp has another meaning, so use the times of arrival.
            steps = np.diff(packets.arrived[packets.begins[-1] :] if packets.begins else packets.arrived)
        else:
            steps = _steps(name, packets)
        if len(steps) < _FEWEST:
            raise NotTried(f"{len(steps)} periods of {name} arrived; {_FEWEST} are needed")
        # A primary package is sent every 12th or 13th cycle, so use the mean period. For other interfaces, use the
        # median, because another check counts missing packets.
        period = float(np.mean(steps) if name == "primary" else np.median(steps))
        measured = 1.0 / period if period > 0.0 else np.inf
        seen = f"{measured:.2f} Hz of {wanted:g} Hz in {len(steps)} periods"
        if abs(measured / wanted - 1.0) > _SLOWER:
            _blame_this_computer(evidence, seen)
        return Measured(abs(measured / wanted - 1.0), seen)

    return check


def _missed(evidence: Evidence) -> Measured:
    packets = _listened(evidence, "realtime")
    times = moments("realtime", packets)
    gaps = gaps_of(times, packets.arrived, (1.0 / _release(evidence).since.rate,), packets.begins[1:])
    lost = sum(gap.cycles for gap in gaps)
    longest = max((gap.seconds for gap in gaps), default=0.0)
    seen = f"{lost} of {lost + len(times)} cycles in {len(gaps)} gaps, the longest {longest * 1e3:.0f} ms"
    if lost:
        _blame_this_computer(evidence, seen)
    return Measured(lost / (lost + len(times)), seen)


def _late(evidence: Evidence) -> Measured:
    packets = _listened(evidence, "realtime")
    delays = packets.arrived - moments("realtime", packets)
    delays = delays - delays.min()
    late = float(np.quantile(delays, 0.99))
    seen = f"99 of 100 within {late * 1e3:.1f} ms, half within {np.median(delays) * 1e3:.2f} ms"
    if late > _HELD_UP:
        _blame_this_computer(evidence, seen)
    return Measured(late, seen)


def _jitter(name: str) -> Check:
    def check(evidence: Evidence) -> Measured:
        packets = _listened(evidence, name)
        delays = packets.arrived - moments(name, packets)
        cycle = 1.0 / (
            125.0
            if name == "rtde" and (evidence.last("rtde") or {}).get("protocol") == 1
            else _release(evidence).since.rate
        )
        middle, most = (float(each) / cycle for each in np.quantile(delays - delays.min(), (0.5, 0.95)))
        seen = f"{name}: half within {middle:.2f} cycles, 95 of 100 within {most:.2f} cycles of {cycle * 1e3:g} ms"
        value = max(middle / _MIDDLE, most / _MOST)
        if value > 1.0:
            _blame_this_computer(evidence, seen)
        return Measured(value, seen)

    return check


def _blame_this_computer(evidence: Evidence, seen: str) -> None:
    """Raise `NotTried` if this computer itself was delayed while it listened, because then nothing can be judged.

    Raises:
        NotTried: If this computer was delayed.
    """
    worst = (evidence.last("woken") or {}).get("worst", 0.0)
    if worst > _HELD_UP:
        raise NotTried(f"this computer itself was delayed by {worst * 1e3:.0f} ms by other programs; {seen}")
    if delayed := evidence.busy(*listening(evidence)):
        raise NotTried(f"this computer was busy: {delayed}; {seen}")


def _forward(evidence: Evidence) -> Measured:
    wrong, count, tried = [], 0, []
    for name in ("realtime", "rtde", "primary"):
        try:
            steps = _steps(name, getattr(evidence, name))
        except NotTried:
            continue
        tried.append(name)
        back = int(np.sum(steps <= 0.0))
        count += back
        if back:
            same = int(np.sum(steps == 0.0))
            wrong.append(f"{name}: {back} of {len(steps)} packets, {same} of them with the time of the previous one")
    if not tried:
        raise NotTried("no interface has sent enough packets with a time")
    return Measured(float(count), counted(wrong, f"each later than the previous one: {', '.join(tried)}").seen)


def _drift(evidence: Evidence) -> Measured:
    packets = evidence.realtime
    times, arrived = moments("realtime", packets), packets.arrived
    # Use only the longest connection, because the controller might have been rebooted between two connections.
    ends = [*packets.begins[1:], len(times)]
    begin, end = max(zip(packets.begins, ends, strict=True), key=lambda each: each[1] - each[0])
    times, delays = times[begin:end], (arrived - times)[begin:end]
    if len(times) < _FEWEST or times[-1] - times[0] < 1.0:
        raise NotTried("the packets span less than 1 s")
    # The line passes through two packets without delay, so all other packets are above the line.
    middle = 0.5 * float(times[0] + times[-1])
    (begun, least), (ended, most) = lowest_edge(zip(times.tolist(), delays.tolist(), strict=True), middle)
    length = ended - begun
    slope = (most - least) / length
    above = delays - least - slope * (times - begun)
    doubt = (2.0 * float(np.quantile(above, 0.05)) + _STAMPED) / length
    seen = f"{-slope * 1e6:+.0f} ppm, with an uncertainty of {doubt * 1e6:.0f} ppm, in {times[-1] - times[0]:.1f} s"
    if doubt > _MOST_DOUBT:
        raise NotTried(f"packets arrived too irregularly to measure the drift of the clock: {seen}")
    # A drift is steady. If a controller was interrupted, for example a simulated one, its packets become late suddenly.
    if (late := max(float(part.min()) for part in np.array_split(above, 8))) > _STEP:
        raise NotTried(
            f"packets were suddenly {late * 1e3:.0f} ms late, so the drift of the clock is uncertain: {seen}"
        )
    return Measured(max(abs(slope) - doubt, 0.0) * 1e6, seen)


ARRIVALS: Mapping[str, Check] = {
    "ports": _ports,
    "identity": _identity,
    "versions-agree": _versions,
    "primary-bytes": _bytes("primary"),
    "secondary-bytes": _bytes("secondary"),
    "realtime-bytes": _bytes("realtime"),
    "rtde-bytes": _bytes("rtde"),
    "unknown-parts": _unknown,
    "realtime-size": _realtime_size,
    "state-size": _state_size,
    "realtime-rate": _rate("realtime"),
    "primary-rate": _rate("primary"),
    "rtde-rate": _rate("rtde"),
    "realtime-missed": _missed,
    "realtime-late": _late,
    "realtime-jitter": _jitter("realtime"),
    "rtde-jitter": _jitter("rtde"),
    "clock-forward": _forward,
    "clock-drift": _drift,
}
