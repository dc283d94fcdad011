"""Metrics of robots, computed at each scrape, so that no old value is kept.

Each metric has the label ``robot``. A value that a robot does not send, or has not sent yet, is absent rather than
zero. For example, a lost arm has no temperatures, and ``urlink_connected`` is 0.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, StateSetMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from urlink import ConnectionState, LinkError, Robot
from urlink.packets import ProgramState, RealtimeState, SafetyMode

__all__ = ["RobotCollector"]

#: Streams whose counters are exported.
_STREAMS = ("realtime", "primary")
#: Counters of a stream, and their descriptions. `missed` is None if the packets have no clock.
_COUNTERS = {
    "received": "packets received",
    "failed": "packets that could not be decoded",
    "missed": "packets that never arrived, by the controller's own clock",
    "duplicates": "packets that arrived twice, by the controller's own clock",
    "dropped": "packets that were dropped because loops over the stream were slow",
    "reconnects": "connections after the first",
    "bytes": "bytes received",
    "skipped": "bytes discarded while searching for a lost frame boundary",
    "unknown": "packets, or parts of packets, of a type without a known layout",
}
_JOINTS = ("base", "shoulder", "elbow", "wrist_1", "wrist_2", "wrist_3")
#: Fields of the real-time interface: metric, description, and labels of its values; None for a single value.
_FIELDS: Mapping[str, tuple[str, str, tuple[str, ...] | None]] = {
    "motor_temperatures": ("urlink_motor_temperature_celsius", "temperature of a joint's motor", _JOINTS),
    "I_actual": ("urlink_joint_current_amperes", "current of a joint", _JOINTS),
    "q_actual": ("urlink_joint_position_radians", "position of a joint", _JOINTS),
    "tcp_force": ("urlink_tcp_force_newtons", "force at the tool", ("x", "y", "z")),
    "speed_scaling": ("urlink_speed_scaling_ratio", "speed at which a program runs, 0 to 1", None),
    "V_main": ("urlink_main_voltage_volts", "voltage of the mainboard", None),
    "I_robot": ("urlink_robot_current_amperes", "current of the robot", None),
}
_MODES = {
    "safety_mode": ("urlink_safety_mode", "safety mode of the controller", SafetyMode),
    "program_state": ("urlink_program_state", "state of the program", ProgramState),
}


class RobotCollector(Collector):
    """Collector that Prometheus reads at each scrape.

    It keeps the robots' streams open until it is closed.

    Args:
        robots: Robots by name. They are not closed with the collector.
    """

    def __init__(self, robots: Mapping[str, Robot]) -> None:
        self._robots = dict(robots)
        self._subscriptions = [
            getattr(robot, stream).subscribe(lambda packet: None)
            for robot in self._robots.values()
            for stream in _STREAMS
        ]

    def close(self) -> None:
        """Stop keeping the streams open; idempotent."""
        for subscription in self._subscriptions:
            subscription.close()

    def describe(self) -> list[Metric]:
        """Return no metrics, so that the robots are not read when the collector is registered."""
        return []

    def collect(self) -> Iterator[Metric]:
        """Yield all metrics, with their current values."""
        yield from self._of_robots()
        yield from self._of_streams()
        states = {name: robot.realtime.latest for name, robot in self._robots.items()}
        known = {name: state for name, state in states.items() if state is not None}
        for field, (metric, what, labels) in _FIELDS.items():
            yield _gauges(metric, what, labels, {name: getattr(state, field) for name, state in known.items()})
        yield from _modes(known)

    def _of_robots(self) -> Iterator[Metric]:
        about = InfoMetricFamily("urlink_robot", "model and firmware", labels=["robot"])
        connected = GaugeMetricFamily("urlink_connected", "1 while packets arrive from the robot", labels=["robot"])
        for name, robot in self._robots.items():
            is_connected = robot.realtime.connection is ConnectionState.CONNECTED
            connected.add_metric([name], float(is_connected))
            with contextlib.suppress(LinkError):  # not known yet
                about.add_metric([name], {"model": robot.model or "", "firmware": str(robot.firmware)})
        yield about
        yield connected

    def _of_streams(self) -> Iterator[Metric]:
        labels = ["robot", "stream"]
        families = {
            counter: CounterMetricFamily(f"urlink_stream_{counter}", what, labels=labels)
            for counter, what in _COUNTERS.items()
        }
        rate = GaugeMetricFamily("urlink_stream_rate_hertz", "packets per second over the last second", labels=labels)
        age = GaugeMetricFamily("urlink_stream_age_seconds", "time since the last packet was read", labels=labels)
        gap = GaugeMetricFamily(
            "urlink_stream_longest_gap_seconds", "longest gap by the controller's clock", labels=labels
        )
        for name, robot in self._robots.items():
            for stream in _STREAMS:
                statistics = getattr(robot, stream).stats
                for counter, family in families.items():
                    value = getattr(statistics, counter)
                    if value is not None:
                        family.add_metric([name, stream], float(value))
                rate.add_metric([name, stream], statistics.rate)
                gap.add_metric([name, stream], statistics.longest_gap)
                if statistics.age is not None:
                    age.add_metric([name, stream], statistics.age)
        yield from (*families.values(), rate, gap, age)


def _gauges(metric: str, what: str, labels: tuple[str, ...] | None, values: Mapping[str, object]) -> GaugeMetricFamily:
    axis = "joint" if labels is _JOINTS else "axis"
    family = GaugeMetricFamily(metric, what, labels=["robot", *((axis,) if labels else ())])
    for name, value in values.items():
        if value is None:  # this firmware does not send it
            continue
        if labels is None:
            family.add_metric([name], float(value))  # type: ignore[arg-type]
        else:
            for label, each in zip(labels, value, strict=False):  # type: ignore[call-overload]
                family.add_metric([name, label], float(each))
    return family


def _modes(known: Mapping[str, RealtimeState]) -> Iterator[StateSetMetricFamily]:
    """Yield each mode as a set of states; the current state is 1, the others are 0."""
    for field, (metric, what, kind) in _MODES.items():
        family = StateSetMetricFamily(metric, what, labels=["robot"])
        for name, state in known.items():
            mode = getattr(state, field)
            if mode is not None:
                family.add_metric([name], {each.name.lower(): each is mode for each in kind})
        yield family
