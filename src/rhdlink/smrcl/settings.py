"""Commands for settings: variables, and parameters, inputs and outputs of control functions.

`commands` has the table of all commands.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import attrgetter

from .arithmetic import cosine, divide, format_number, sine, truncate
from .control_functions import CONTROL_FUNCTIONS
from .effects import MissionEffects
from .expressions import LineFault
from .odometry import Odometry
from .plan import Outcome
from .symbols import split_index

#: Largest number that a setting accepts in the sound profile.
_LARGEST = 1e6

#: Names that `set` accepts for hardware that no current robot has. MRC only stores their values.
_STORED_ONLY = frozenset(
    (
        *("linedetect", "rollpitchon", "rolloffset", "pitchoffset", "paintServoStatus", "kalmanon"),
        *("hakoliftinggearstateref", "hakopowertakeoffstateref"),
    )
)
#: Names of `set` that write a variable of the robot.
_WRITTEN = {"hakomanual": "hakomanual", "hakoenginespeed": "enginespeedref"}


def make_array(effects: MissionEffects, name: str, size: float) -> Outcome:
    """`array`: make an array of zeros."""
    count = truncate(size)
    if count < 0 or effects.symbols.make_array(name, count) is None:
        raise LineFault(
            f"there is no room for an array of {format_number(size)} values; {effects.symbols.free} are free",
            is_limit=True,
        )
    return effects.at_once()


def transform(effects: MissionEffects, x0: float, y0: float, th0: float, x: float, y: float, th: float) -> Outcome:
    """`trans`: transform a pose from the frame of another pose.

    The result is in `$res0` to `$res2`, in m and rad.
    """
    c, s = cosine(th0), sine(th0)
    return _set_results(effects, c * x - s * y + x0, s * x + c * y + y0, th + th0)


def transform_back(effects: MissionEffects, x0: float, y0: float, th0: float, x: float, y: float, th: float) -> Outcome:
    """`invtrans`: transform a pose into the frame of another pose.

    The result is in `$res0` to `$res2`, in m and rad.
    """
    c, s = cosine(th0), sine(th0)
    return _set_results(effects, c * (x - x0) + s * (y - y0), -s * (x - x0) + c * (y - y0), th - th0)


def _set_results(effects: MissionEffects, *values: float) -> Outcome:
    for number, value in enumerate(values):
        effects.symbols.pool[effects.symbols.system[f"res{number}"].place] = value
    return effects.at_once()


def set_value(effects: MissionEffects, name: str, value: float) -> Outcome:
    """`set`: set a variable of the script, a system variable or a setting."""
    special = _SETTINGS.get(name)
    if special is not None:
        _check(effects, f'set "{name}"', value, is_positive=name == "odowidth")
        special(effects, value)
    elif name in _STORED_ONLY:
        if effects.profile.needs_are_checked:
            raise LineFault(f'set "{name}" is for hardware that this robot does not have')
    elif name in _WRITTEN:
        variable = _WRITTEN[name]
        if not effects.vehicle.outputs.set_word(variable, value) and effects.profile.needs_are_checked:
            raise LineFault(f'set "{name}" needs the write variable {variable}, which this robot does not have')
    else:
        _set_variable(effects, name, value)
    return effects.at_once()


def _check(effects: MissionEffects, what: str, value: float, *, is_positive: bool = False) -> None:
    if not effects.profile.numbers_are_checked:
        return
    if not abs(value) <= _LARGEST or (is_positive and value <= 0.0):
        expected = "a number above 0" if is_positive else "a number"
        raise LineFault(f"{what} takes {expected} of at most {_LARGEST:g}, not {format_number(value)}")


def _set_variable(effects: MissionEffects, text: str, value: float) -> None:
    name, index = split_index(text)
    symbol = effects.symbols.user.get(name)
    if symbol is None and name[:1] == "$":
        symbol = effects.symbols.find_system(name[1:])
    if symbol is None:
        effects.reject_name(f"there is no variable {name}")
        return
    place = symbol.place + index
    if effects.profile.indices_are_checked and not 0 <= index < symbol.size:
        raise LineFault(f"index {index} is beyond {name}, which has {symbol.size} values")
    if 0 <= place < len(effects.symbols.pool):
        effects.symbols.pool[place] = value


def _set_counter(effects: MissionEffects, value: float) -> None:
    if not effects.interpreter.compiler.reset_counter(truncate(value)):
        effects.reject_name(f"there is no condition counter {format_number(value)}; expected 0 to 9")


def _set_odometry_ratio(effects: MissionEffects, ratio: float) -> None:
    odometry = effects.vehicle.odometry
    _set_odometry_scales(odometry, ratio, (odometry.right_scale + odometry.left_scale) / 2)


def _set_odometry_mean(effects: MissionEffects, mean: float) -> None:
    odometry = effects.vehicle.odometry
    _set_odometry_scales(odometry, divide(odometry.right_scale, odometry.left_scale), mean)


def _set_odometry_scales(odometry: Odometry, ratio: float, mean: float) -> None:
    odometry.right_scale = divide(2 * ratio, 1 + ratio) * mean
    odometry.left_scale = divide(2, 1 + ratio) * mean


def _set_kalman(effects: MissionEffects, value: float) -> None:
    vehicle = effects.vehicle
    if value and "xkalman" not in vehicle.variables.external and effects.profile.needs_are_checked:
        raise LineFault('set "usekalmanodo" needs a filter that provides $xkalman, $ykalman and $thkalman')
    vehicle.uses_kalman = truncate(value) != 0
    vehicle.control.target = vehicle.kalman_pose()


def set_output(effects: MissionEffects, text: str, value: float) -> Outcome:
    """`setoutput`: set a write variable of the robot."""
    name, index = split_index(text)
    if not effects.vehicle.outputs.set(name, index, value):
        effects.reject_name(f"the robot has no write variable {text}")
    return effects.at_once()


def set_offset(effects: MissionEffects, text: str, value: float) -> Outcome:
    """`setoffset`: set the offset of a variable of the robot."""
    return _scaled(effects, text, "offset", value, effects.symbols.set_scale(*split_index(text), offset=value))


def set_gain(effects: MissionEffects, text: str, value: float) -> Outcome:
    """`setgain`: set the gain of a variable of the robot."""
    return _scaled(effects, text, "gain", value, effects.symbols.set_scale(*split_index(text), gain=value))


def _scaled(effects: MissionEffects, text: str, what: str, value: float, is_there: bool) -> Outcome:
    if is_there:
        effects.output.message(f" {what} assigned {format_number(value)}\n")
    else:
        effects.reject_name(f"the robot has no variable {text}")
    return effects.at_once()


def set_parameter(effects: MissionEffects, module: str, function: str, name: str, value: float) -> Outcome:
    """`setpar`: set a parameter of a control function."""
    _check(effects, f"setpar of {name}", value)
    if not effects.vehicle.functions.set_parameter(module, function, name, value):
        _reject_path(effects, module, function, f"{name} of {module} {function} is not a parameter")
    return effects.at_once()


def route_input(effects: MissionEffects, module: str, function: str, name: str, text: str) -> Outcome:
    """`routeinput`: take an input of a control function from a system variable."""
    variable, index = split_index(text)
    if not effects.vehicle.functions.has_input(module, function, name):
        _reject_path(effects, module, function, f"{name} of {module} {function} is not an input")
        return effects.at_once()
    symbol = effects.symbols.find_system(variable)
    if symbol is None:
        effects.reject_name(f"the robot has no variable {variable}", " input variable not found \n")
    elif 0 <= symbol.place + index < len(effects.symbols.pool):
        effects.vehicle.functions.route_input(module, function, name, symbol.place + index)
    return effects.at_once()


def route_output(effects: MissionEffects, source: str, text: str) -> Outcome:
    """`routeoutput`: send the output of `funcgen` to a write variable of the robot."""
    name, index = split_index(text)
    if name not in effects.symbols.outputs:
        effects.reject_name(f"the robot has no write variable {name}", "output not found\n")
    elif source != "funcgen":
        effects.reject_name(f'there is no generator "{source}"; expected funcgen', "input not found\n")
    else:
        effects.vehicle.generator_output = name, index
    return effects.at_once()


def _reject_path(effects: MissionEffects, module: str, function: str, reason: str) -> None:
    if module not in CONTROL_FUNCTIONS:
        effects.reject_name(f'there is no module "{module}"', "module not found\n")
    elif function not in CONTROL_FUNCTIONS[module]:
        effects.reject_name(f'{module} has no "{function}"', "paramlist not found\n")
    effects.reject_name(reason, "parameter not found \n")


def _setter(path: str) -> Callable[[MissionEffects, float], None]:
    """Return a function that sets an attribute of the vehicle, such as ``odometry.pose.x``."""
    owner, _, attribute = path.rpartition(".")

    def set_value(effects: MissionEffects, value: float) -> None:
        setattr(attrgetter(owner)(effects.vehicle) if owner else effects.vehicle, attribute, value)

    return set_value


_SETTINGS: Mapping[str, Callable[[MissionEffects, float], None]] = {
    "$odox": _setter("odometry.pose.x"),
    "$odoy": _setter("odometry.pose.y"),
    "$odoth": _setter("odometry.pose.th"),
    "$gyro1off": _setter("heading_offset"),
    "$gyro1gain": _setter("heading_gain"),
    "$odocovE2": _setter("covariance.wheel"),
    "$odocovA2": _setter("covariance.base"),
    "odowidth": _setter("odometry.width"),
    "odocontrol": lambda effects, value: setattr(effects.vehicle.odometry, "heading_source", truncate(value)),
    "gyrotype": lambda effects, value: setattr(effects.vehicle.odometry, "is_rate", truncate(value) != 0),
    "odoratio": _set_odometry_ratio,
    "odoc0": _set_odometry_mean,
    "conditioncounter": _set_counter,
    "usekalmanodo": _set_kalman,
    "xmlon": lambda effects, value: setattr(effects.client, "uses_xml", truncate(value) != 0),
}
