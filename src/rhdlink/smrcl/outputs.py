"""What a mission writes: speeds and outputs, as the words of the robot's write variables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from .motion.control import DriveKind
from .profile import Profile
from .robot_conf import RobotConf
from .symbols import Symbols

_INT_MIN, _INT_MAX = -(2**31), 2**31 - 1


class VehicleOutputs:
    """The write variables of a robot.

    Args:
        conf: what the robot is.
        symbols: the variables of the mission.
        write: the values of the write variables, by name.
        profile: as MRC does it, or sound.
    """

    def __init__(self, conf: RobotConf, symbols: Symbols, write: Mapping[str, Sequence[int]], profile: Profile) -> None:
        self._symbols = symbols
        self._is_velomega = conf.drive is DriveKind.VELOMEGA
        self._scales = conf.left_speed_scale, conf.right_speed_scale
        self._speeds = conf.writes
        self._words = {name: list(map(int, words)) for name, words in write.items()}
        self._changed: dict[str, list[int]] = {}
        self._count: Callable[[float], int] = _nearest
        self._count_speed: Callable[[float], int] = _nearest
        if not profile.outputs_round_alike:
            self._count = _half_up_to_zero
            self._count_speed = _truncated if self._is_velomega else _half_up

    @property
    def has_speed(self) -> bool:
        """Whether the speeds that are written are not all 0."""
        return any(self._words[name][0] for name in self._speeds)

    def set_speeds(self, left: float, right: float, omega: float) -> None:
        """Write the speeds of the wheels, m/s, or of a velocity-omega robot `left` and the turn rate, rad/s."""
        speeds = left, omega if self._is_velomega else right
        for name, scale, speed in zip(self._speeds, self._scales, speeds, strict=True):
            self._put(name, self._count_speed(speed * scale))

    def set(self, name: str, index: int, value: float) -> bool:
        """Write ``(value + offset) * gain`` to a variable, rounded. False if the robot has no such one."""
        symbol = self._symbols.outputs.get(name)
        if symbol is None or not 0 <= index < symbol.size:
            return False
        pool, place = self._symbols.pool, symbol.place + index
        pool[place] = value
        scaled = (value + pool[place + symbol.size]) * pool[place + 2 * symbol.size]
        self._put(name, self._count(scaled), index)
        return True

    def set_word(self, name: str, value: float) -> bool:
        """Write the first word of a variable, without offset and gain. False if the robot has no such one."""
        if name not in self._words:
            return False
        self._put(name, _truncated(value))
        return True

    def reset_motors(self) -> None:
        """Write the variables that reset the motors, where the robot has them."""
        for name in ("resetmotorr", "resetmotorl"):
            if name in self._words:
                self._changed[name] = self._words[name]

    def _put(self, name: str, word: int, index: int = 0) -> None:
        words = self._words[name]
        words[index] = word
        self._changed[name] = words

    def take_changed(self) -> dict[str, list[int]]:
        """What was set since the last call, by name; whole variables."""
        changed, self._changed = self._changed, {}
        return {name: list(words) for name, words in changed.items()}


# How numbers become words. nan is 0 and what does not fit the nearest word; MRC would send -2147483648 for both.


def _truncated(value: float) -> int:
    return 0 if value != value else int(max(_INT_MIN, min(_INT_MAX, value)))


def _nearest(value: float) -> int:
    whole = _truncated(abs(value) + 0.5)
    return -whole if value < 0 else whole


def _half_up_to_zero(value: float) -> int:
    """C's conversion of ``value + 0.5``, as MRC's `setoutput` does it: -3 becomes -2."""
    return _truncated(value + 0.5)


def _half_up(value: float) -> int:
    """``floor(value + 0.5)``, as MRC rounds the speeds of wheels."""
    return 0 if value != value else int(max(_INT_MIN, min(_INT_MAX, value + 0.5)) // 1)
