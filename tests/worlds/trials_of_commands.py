"""Trials of commands and queries: outputs, settings, stops, programs, statements, RTDE, dashboard and gripper."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import urlink
from linkcore.errors import BadValue, Cancelled, Closed, LinkError, LinkTimeout
from linkcore.handle import Phase
from urlink.errors import NotEnabled, SafetyStop

from .trials import NEAR, Bench, trial

_READY = np.array([0.0, -1.57, 1.57, -1.57, -1.57, 0.0])


def _has_rtde(bench: Bench) -> bool:
    return not bench.controller.firmware.is_cb2


@trial
def outputs(bench: Bench) -> None:
    """Confirmed outputs and read inputs equal the values of the controller."""
    signals, io = bench.controller.signals, bench.robot.io
    if bench.chance.random() < 0.5:
        other = urlink.connect(bench.host, timeout=3.0, commands_via="script")
        io = other.io
    else:
        other = None
    for _ in range(4):
        number, on = bench.chance.randrange(8), bench.chance.random() < 0.5
        kind, first, count = bench.chance.choice((("", 0, 8), ("configurable_", 8, 8), ("tool_", 16, 2)))
        number %= count
        before = signals.digital_outputs
        getattr(io, f"set_{kind}digital_out")(number, on)
        expected = before | 1 << (first + number) if on else before & ~(1 << (first + number))
        bench.check(
            signals.digital_outputs == expected, f"{kind}{number}={on}: {before:b} became {signals.digital_outputs:b}"
        )
        bench.check(getattr(io, f"{kind}digital_out")(number) is on, f"{kind}digital_out({number}) is not {on}")
    for number in (0, 1):
        fraction = bench.chance.random()
        io.set_analog_out(number, fraction)
        shown = io.analog_out(number)
        has, domain = signals.analog_outputs[number], signals.analog_output_domains[number]
        bench.check(
            abs(shown.value - has) < 1e-3 * max(abs(has), 1e-3), f"analog_out({number}) {shown}, but it has {has}"
        )
        bench.check(shown.domain == domain, f"analog_out({number}) {shown}, but its domain is {domain}")
        full = 10.0 if domain else 0.016
        least = 0.0 if domain else 0.004
        bench.check(abs((has - least) / full - fraction) < 0.01, f"{fraction:.3f} was set, but it is {has}")
    values = [0.004 + 0.01 * bench.chance.random() for _ in range(4)]
    for number, value in enumerate(values):
        signals.analog_inputs[number] = value
    time.sleep(0.3)
    for number in (0, 1):
        bench.check(abs(io.analog_in(number).value - values[number]) < 1e-4, f"analog_in({number})")
        bench.check(abs(io.tool_analog_in(number).value - values[2 + number]) < 1e-4, f"tool_analog_in({number})")
    volts = bench.chance.choice((0, 12, 24))
    io.set_tool_voltage(volts)
    bench.check(signals.tool_output_voltage == volts == io.tool_voltage, f"{volts} V: {io.tool_voltage}")
    with bench.raises(BadValue):
        io.set_digital_out(8, True)
    with bench.raises(BadValue):
        io.set_analog_out(2, 0.5)
    with bench.raises(BadValue):
        io.digital_in(-1)
    if other is not None:
        other.close()


@trial
def unconfirmed(bench: Bench) -> None:
    """A setting raises if the controller does not show it within `confirm` seconds."""
    io, robot = bench.robot.io, bench.robot
    io.set_digital_out(0, False)
    seconds = 0.2 + 0.3 * bench.chance.random()
    calls: dict[str, Callable[[float | None], object]] = {
        "digital": lambda confirm: io.set_digital_out(0, True, confirm=confirm),
        "analog": lambda confirm: io.set_analog_out(1, 0.7, confirm=confirm),
        "slider": lambda confirm: robot.set_speed_slider(0.6, confirm=confirm),
        "payload": lambda confirm: robot.set_payload(0.7, confirm=confirm),
        "voltage": lambda confirm: io.set_tool_voltage(12, confirm=confirm),
    }
    call = calls[bench.chance.choice(sorted(calls))]
    robot.primary.wait(2.0)
    with bench.silence():
        begun = bench.now
        try:
            call(seconds)
        except LinkError:
            took = bench.now - begun
            bench.check(took < seconds + 3.0, f"it raised after {took:.2f} s, confirm={seconds:.2f}")
        else:
            bench.check(bench.now - begun < 0.1, "a setting of a silent controller was confirmed")
    time.sleep(2.0)


@trial
def settings(bench: Bench) -> None:
    """Confirmed settings are the values of the controller."""
    robot, controller, chance = bench.robot, bench.controller, bench.chance
    mass = round(2.0 * chance.random(), 3)
    cog = [0.0, 0.01, round(0.1 * chance.random(), 3)]
    robot.set_payload(mass, cog)
    tcp = [0.0, 0.0, round(0.1 * chance.random(), 3), 0.0, 0.0, 0.0]
    robot.set_tcp(tcp)
    fraction = 0.2 + 0.8 * chance.random()
    robot.set_speed_slider(fraction)
    bench.check(abs(controller.speed_fraction - fraction) < 0.01, f"the slider is at {controller.speed_fraction}")
    state = robot.realtime.wait(2.0)
    if state.payload_mass is not None:
        bench.check(abs(state.payload_mass - mass) < 1e-3, f"{mass} kg was set, but it reports {state.payload_mass}")
        bench.check(np.allclose(state.payload_cog, cog, atol=1e-3), f"{cog} was set, but it has {state.payload_cog}")
    expected = robot.kinematics.forward(state.q_actual, tcp=tcp)
    bench.check(np.allclose(expected[:3], state.tool_vector_actual[:3], atol=0.01), "the TCP has another value")
    with bench.raises(BadValue):
        robot.set_payload(-1.0)
    number = chance.randrange(32)
    robot.io.set_flag(number, True)
    time.sleep(0.3)
    bench.check(controller.flags[number], f"flag {number}")


@trial
def policies(bench: Bench) -> None:
    """With "on_startup", motions need `enable` once; with "always", they need it again after every stop."""
    policy: Any = bench.chance.choice(("on_startup", "always"))
    with urlink.connect(bench.host, timeout=3.0, require_enable=policy) as robot:
        safety = robot.safety
        goal = _READY + 0.1
        bench.check(safety.policy == policy, f"the policy is {safety.policy}")
        bench.check(not safety.is_enabled, "it is enabled before enable()")
        with bench.raises(NotEnabled, within=1.0):
            robot.motion.move_joints(goal)
        with bench.raises(LinkTimeout, after=0.3):
            safety.wait_enabled(0.3)
        thread, outcome = bench.ended(lambda: safety.wait_enabled(5.0))
        time.sleep(0.1)
        safety.enable()
        at = bench.now
        if bench.joined(thread, 1.0):
            bench.check(outcome[0] is None and outcome[-1] - at < NEAR + 0.1, f"wait_enabled: {outcome}, {at}")
        bench.check(safety.is_enabled, "it is not enabled after enable()")
        robot.motion.move_joints(goal, wait=True)
        bench.controller.faults.protective_stop()
        time.sleep(0.5)
        with bench.raises(LinkError, within=1.0):
            robot.motion.move_joints(_READY)
        bench.controller.faults.clear()
        safety.wait_until_clear(5.0)
        time.sleep(0.3)
        if policy == "always":
            with bench.raises(NotEnabled, within=1.0):
                robot.motion.move_joints(_READY)
            bench.check(isinstance(safety.refusal, NotEnabled), f"the refusal is {safety.refusal!r}")
            safety.enable()
        robot.motion.move_joints(_READY, wait=True)
        motion = robot.motion.move_joints(goal, speed=0.05)
        time.sleep(0.1)
        safety.policy = "always"
        is_enabled = safety.is_enabled
        time.sleep(0.3)
        if policy == "always":
            bench.check(is_enabled and not motion.done, "setting the same policy again stops a motion")
        motion.cancel()
        safety.policy = "never"
        bench.check(safety.is_enabled, 'the policy "never" requires enable()')


@trial
def stops(bench: Bench) -> None:
    """A stop is reported once to each callback and to waiting calls, and ends motions; its end is reported, too."""
    robot, faults = bench.robot, bench.controller.faults
    notified: list[LinkError] = []
    others: list[LinkError] = []
    end = robot.safety.on_stop(notified.append)
    robot.safety.on_stop(others.append)
    bench.check(robot.safety.wait_for_stop(0.1) is None, "a stop is reported without a stop")
    bench.check(robot.safety.cause is None and robot.safety.refusal is None, f"{robot.safety.cause}")
    motion = robot.motion.move_joints(_READY + 0.3, speed=0.1)
    time.sleep(0.2)
    thread, outcome = bench.ended(lambda: robot.safety.wait_for_stop(5.0))

    def wait_until_clear() -> None:
        time.sleep(0.5)
        robot.safety.wait_until_clear(5.0)

    clear, cleared = bench.ended(wait_until_clear)
    time.sleep(0.1)
    kind = bench.chance.choice(("protective_stop", "emergency_stop", "safeguard_stop"))
    at = bench.now
    getattr(faults, kind)()
    late = NEAR + (0.15 if bench.controller.firmware.is_cb2 else 0.0)
    if bench.joined(thread, 1.0):
        bench.check(isinstance(outcome[0], SafetyStop), f"wait_for_stop gave {outcome[0]!r}")
        bench.check(outcome[1] - at < late + 0.1, f"wait_for_stop took {outcome[1] - at:.3f} s")
    begun = bench.now
    with bench.raises(SafetyStop, within=0.5):
        motion.wait(5.0)
    bench.check(bench.now - begun < 0.5, "the motion did not end")
    time.sleep(0.2)
    bench.check(
        len(notified) == 1 and len(others) == 1, f"{kind}: on_stop was called {len(notified)} and {len(others)} times"
    )
    bench.check(robot.safety.cause is not None, "no cause")
    bench.check(kind.split("_")[0] in str(robot.safety.cause).lower(), f"{kind}: the cause is {robot.safety.cause}")
    bench.check(robot.motion.current is None, "a stopped motion is the current one")
    end()
    with bench.raises(LinkTimeout, after=0.2):
        robot.safety.wait_until_clear(0.2)
    with bench.raises(SafetyStop, LinkError, within=1.5):
        robot.motion.move_joints(_READY)
    at = bench.now
    faults.clear()
    if kind == "emergency_stop":
        faults.power_on()
    if bench.joined(clear, 3.0):
        bench.check(not isinstance(cleared[0], LinkError), f"wait_until_clear: {cleared[0]!r}")
        bench.check(kind == "emergency_stop" or cleared[1] - max(at, begun) < 0.7, f"it took {cleared[1] - at:.2f} s")
    robot.safety.wait_until_clear(5.0)
    bench.controller.call(bench.controller.pendant.stop)
    time.sleep(0.3)
    faults.protective_stop()
    time.sleep(0.4)
    bench.check(len(notified) == 1, "a removed callback was called")
    bench.check(len(others) == 2, f"on_stop was called {len(others)} times at the second stop")
    faults.clear()
    robot.safety.wait_until_clear(5.0)
    robot.motion.move_joints(_READY + 0.05, wait=True)


@trial
def a_silent_robot(bench: Bench) -> None:
    """After `stale_after` seconds without a packet, motions end and new motions are refused."""
    seconds = 0.4 + 0.3 * bench.chance.random()
    with urlink.connect(bench.host, timeout=3.0, stale_after=seconds) as robot:
        motion = robot.motion.move_joints(_READY + 0.5, speed=0.1)
        time.sleep(0.3)
        with bench.silence():
            begun = bench.now
            with bench.raises(LinkError, after=seconds - 0.12, within=0.6):
                motion.wait(5.0)
            bench.check(motion.done and motion.phase is Phase.FAILED, f"{motion.phase}")
            with bench.raises(LinkError, within=4.0):
                robot.motion.move_joints(_READY)
            bench.check(bench.now - begun < 6.0, f"it took {bench.now - begun:.2f} s")
            with bench.raises(LinkTimeout, after=0.2, within=0.5):
                robot.safety.wait_until_clear(0.2)
        time.sleep(4.0)
        robot.safety.wait_until_clear(10.0)
        robot.motion.stop(wait=5.0)


@trial
def scripts(bench: Bench) -> None:
    """A program reports its texts in order, its end and its error; its actions take effect."""
    robot, controller = bench.robot, bench.controller
    texts: list[str] = []
    number = bench.chance.randrange(8)
    before = bool(controller.signals.digital_outputs >> number & 1)
    source = (
        f'def p():\n  textmsg("first")\n  sleep(0.1)\n  set_digital_out({number}, {not before})\n'
        '  textmsg("second")\n  sleep(0.1)\n  textmsg("third")\nend\n'
    )
    begun = bench.now
    done: list[Any] = []
    program = robot.script.run(source, on_text=texts.append)
    program.add_done_callback(done.append)
    bench.check(not program.done, "it is done immediately")
    program.wait(5.0)
    took = bench.now - begun
    bench.check(0.2 <= took < 1.0, f"a program of 0.2 s took {took:.2f} s")
    time.sleep(0.1)
    bench.check(texts == ["first", "second", "third"], f"its texts: {texts}")
    bench.check(done == [program], f"done callbacks: {done}")
    bench.check(program.phase is Phase.DONE and program.error is None, f"{program.phase}, {program.error!r}")
    bench.check(bool(controller.signals.digital_outputs >> number & 1) is not before, "its output is not set")
    for wrong in ("def p():\n  movj([0])\nend\n", "def p():\n  sleep(0.1)\n  movej([1, 2])\nend\n"):
        failed = robot.script.run(wrong)
        with bench.raises(LinkError, within=3.0):
            failed.wait(5.0)
        bench.check(failed.phase is Phase.FAILED and failed.error is not None, f"{failed.phase}")
    long = robot.script.run("sleep(5)")
    with bench.raises(LinkTimeout, after=0.3):
        long.wait(0.3, cancel=False)
    bench.check(not long.done, "wait(cancel=False) ended it")
    long.cancel()
    with bench.raises(Cancelled, within=1.0):
        long.wait(2.0)
    time.sleep(0.5)
    bench.check(not controller.is_running_program, "a cancelled program keeps running")
    robot.script.run("sec s():\n  set_flag(3, True)\nend", wait=5.0)
    bench.check(controller.flags[3], "a secondary program had no effect")
    on = bench.chance.random() < 0.5
    robot.script.send_line(f"set_digital_out(2, {on})")
    time.sleep(0.2)
    bench.check(bool(controller.signals.digital_outputs >> 2 & 1) is on, "a line had no effect")


@trial
def interpreter(bench: Bench) -> None:
    """Statements are executed in order and numbered; skipped or aborted statements are not executed."""
    from urlink.protocol.firmware import Firmware

    if bench.controller.firmware < Firmware.parse("5.10"):
        with bench.raises(LinkError), bench.robot.interpreter():
            pass
        return
    robot, controller = bench.robot, bench.controller
    texts: list[str] = []
    bits = [bench.chance.random() < 0.5 for _ in range(3)]
    with robot.interpreter(on_text=texts.append, finish_timeout=5.0) as mode:
        numbers = [mode.execute(f"set_digital_out({number}, {on})") for number, on in enumerate(bits)]
        numbers.append(mode.execute('textmsg("here")', wait=3.0))
        bench.check(all(b == a + 1 for a, b in itertools.pairwise(numbers)), f"the numbers are {numbers}")
        for number, on in enumerate(bits):
            bench.check(bool(controller.signals.digital_outputs >> number & 1) is on, f"statement {number} is not done")
        begun = bench.now
        mode.execute("sleep(0.4)")
        mode.wait_executed(3.0)
        bench.check(0.35 < bench.now - begun < 0.9, f"a statement of 0.4 s took {bench.now - begun:.2f} s")
        state = mode.state
        bench.check(state.last_executed >= numbers[-1], f"{state}")
        mode.execute("sleep(3)")
        with bench.raises(LinkTimeout, after=0.3, within=0.3):
            mode.wait_executed(0.3)
        how = bench.chance.choice(("abort", "skip"))
        mode.execute(f"set_digital_out(5, {not controller.signals.digital_outputs >> 5 & 1})")
        before = controller.signals.digital_outputs
        if how == "skip":
            mode.skip()
        mode.abort()
        time.sleep(0.3)
        if how == "skip":
            bench.check(controller.signals.digital_outputs == before, "a skipped statement was executed")
        with bench.raises(LinkError, within=2.0):
            mode.execute("movj(1)", wait=2.0)
        count = mode.clear()
        bench.check(count >= 0, f"{count}")
    bench.check(mode.done and mode.phase is Phase.DONE, f"{mode.phase}: {mode.error!r}")
    bench.check(texts == ["here"], f"its texts: {texts}")
    time.sleep(0.3)
    bench.check(not controller.is_running_program, "its program keeps running after its block")
    with bench.raises(LinkError):
        mode.execute("sleep(0)")


@trial
def registers(bench: Bench) -> None:
    """Written and read registers equal the values of the controller; two clients cannot claim the same register."""
    if not _has_rtde(bench):
        return
    robot, banks, chance = bench.robot, bench.controller.registers, bench.chance
    number, bit = chance.randrange(24, 48), chance.randrange(64, 128)
    values = chance.randrange(1000), chance.random(), chance.random() < 0.5
    robot.registers.write_integer(number, values[0])
    robot.registers.write_float(number, values[1])
    robot.registers.write_bit(bit, values[2])
    time.sleep(0.1)
    has = banks.inputs.integers[number], banks.inputs.floats[number], bool(banks.inputs.bits >> bit & 1)
    bench.check(has == values, f"{values} were written, but it has {has}")
    banks.outputs.integers[number], banks.outputs.floats[number] = chance.randrange(1000), chance.random()
    time.sleep(0.1)
    bench.check(robot.registers.read_integer(number) == banks.outputs.integers[number], "read_integer")
    bench.check(robot.registers.read_float(number) == banks.outputs.floats[number], "read_float")
    bench.check(robot.registers.read_bit(bit) is bool(banks.outputs.bits >> bit & 1), "read_bit")
    other = urlink.connect(bench.host, timeout=3.0)
    with bench.raises(urlink.InputInUse, within=2.0):
        other.registers.write_integer(number, 1)
    holders = other.rtde.who_holds()
    held = {name for name in holders if name.startswith("input_int_register")}
    bench.check(held == {f"input_int_register_{number}"} or len(held) > 1, f"held are {sorted(holders)}")
    if chance.random() < 0.5:
        bench.reset()
        time.sleep(1.5)
    else:
        with bench.silence(), bench.raises(LinkError, within=6.0):
            robot.registers.write_integer(24 + (number - 23) % 24, 1)
        time.sleep(3.0)
    robot.registers.write_integer(number, 7)
    time.sleep(0.1)
    bench.check(banks.inputs.integers[number] == 7, "no register is written after the connection was lost")
    robot.rtde.close()
    time.sleep(0.2)
    other.registers.write_integer(number, 5)
    time.sleep(0.1)
    bench.check(banks.inputs.integers[number] == 5, "a register of a closed client is still claimed")
    with bench.raises(LinkError):
        robot.registers.write_integer(number, 1)
    other.close()


@trial
def rtde_outputs(bench: Bench) -> None:
    """An RTDE stream has the requested variables at the requested frequency, even after a reconnection."""
    if not _has_rtde(bench):
        return
    robot, chance, controller = bench.robot, bench.chance, bench.controller
    frequency = chance.choice((25.0, 62.5, 125.0))
    number = chance.randrange(24)
    controller.registers.outputs.integers[number] = chance.randrange(1000)
    names = ("timestamp", "actual_q", f"output_int_register_{number}", "actual_digital_output_bits")
    with robot.rtde.outputs(*names, frequency=frequency) as stream:
        seen: list[Any] = []
        subscription = stream.subscribe(seen.append)
        time.sleep(0.5)
        periods = np.diff([state.timestamp for state in seen])
        bench.check(np.allclose(periods, 1.0 / frequency, atol=1e-3), f"{frequency} Hz: {periods.tolist()}")
        bench.check(abs(len(seen) - 0.5 * frequency) < 4 + NEAR * frequency, f"{len(seen)} rows in 0.5 s")
        state = stream.wait(2.0)
        has = getattr(state, names[2])
        bench.check(has == controller.registers.outputs.integers[number], f"{names[2]} is {has}")
        bench.check(np.allclose(state.actual_q, controller.arm.setpoint.q, atol=0.02), "actual_q")
        bench.check(state.actual_digital_output_bits == controller.signals.digital_outputs, "the outputs")
        before = len(seen)
        bench.reset()
        time.sleep(2.0)
        bench.check(len(seen) > before + 10, "no rows arrive after the connection was lost")
        bench.check(stream.stats.reconnects == 1, f"{stream.stats}")
        periods = np.diff([state.timestamp for state in seen[-10:]])
        bench.check(np.allclose(periods, 1.0 / frequency, atol=1e-3), f"{frequency} Hz after it: {periods.tolist()}")
        subscription.close()
    with bench.raises(Closed):
        stream.wait(1.0)
    with bench.raises(LinkError):
        robot.rtde.outputs("no_such_variable").start()
    left = robot.rtde.outputs("actual_q", "tool_temperature", missing="leave_out")
    left.close()


@trial
def rtde_inputs(bench: Bench) -> None:
    """Sent inputs are the values of the controller; claims are released, and renewed after a reconnection."""
    if not _has_rtde(bench):
        return
    robot, chance, controller = bench.robot, bench.chance, bench.controller
    with robot.rtde.inputs("speed_slider_fraction", "standard_digital_output") as inputs:
        fraction = 0.3 + 0.7 * chance.random()
        number, on = chance.randrange(8), chance.random() < 0.5
        inputs.send(speed_slider_fraction=fraction, standard_digital_output={number: on})
        time.sleep(0.1)
        bench.check(abs(controller.speed_fraction - fraction) < 1e-3, f"the slider is at {controller.speed_fraction}")
        bench.check(bool(controller.signals.digital_outputs >> number & 1) is on, f"output {number} is not {on}")
        with urlink.connect(bench.host, timeout=3.0) as other:
            with bench.raises(urlink.InputInUse, within=2.0):
                other.rtde.inputs("speed_slider_fraction").send(speed_slider_fraction=0.5)
            bench.check("speed_slider_fraction" in other.rtde.who_holds(), f"{other.rtde.who_holds()}")
            other.set_speed_slider(0.77)  # uses a script, because another client holds the input
            bench.check(abs(controller.speed_fraction - 0.77) < 0.01, "set_speed_slider despite a claim")
        bench.reset()
        time.sleep(2.0)
        inputs.send(speed_slider_fraction=0.9)
        time.sleep(0.1)
        bench.check(abs(controller.speed_fraction - 0.9) < 1e-3, "no input is set after the connection was lost")
        for wrong in ({"speed_slider_fraction": 7.0}, {"nothing": 1}):
            with bench.raises(LinkError):
                inputs.send(**wrong)
    with bench.raises(LinkError):
        inputs.send(speed_slider_fraction=0.5)
    bench.check(inputs.is_over, "it has not ended after close")
    again = robot.rtde.inputs("speed_slider_fraction")
    again.send(speed_slider_fraction=0.6)
    time.sleep(0.1)
    bench.check(abs(controller.speed_fraction - 0.6) < 1e-3, "a released input cannot be claimed")
    again.close()


@trial
def dashboard(bench: Bench) -> None:
    """Replies of the dashboard match the controller, and its commands take effect."""
    robot, controller = bench.robot, bench.controller
    dash = robot.dashboard
    with bench.raises(LinkError):
        dash.load("/programs/none.urp")
    dash.load("/programs/pick.urp")
    bench.check("pick" in str(dash.loaded_program()), f"{dash.loaded_program()}")
    dash.play()
    time.sleep(0.2)
    has_server = bench.controller.firmware.major < 10
    bench.check(controller.is_running_program and (not has_server or dash.running()), "it does not play")
    dash.pause()
    time.sleep(0.3)
    bench.check(np.abs(robot.realtime.wait(2.0).qd_actual).max() < 0.05, "it moves while it is paused")
    bench.check("PAUSED" in str(dash.program_state()).upper(), f"{dash.program_state()}")
    dash.stop()
    time.sleep(0.3)
    bench.check(not controller.is_running_program and not (has_server and dash.running()), "it does not stop")
    if bench.chance.random() < 0.5:
        dash.power_off()
        time.sleep(0.5)
        bench.check(
            not has_server or dash.robot_mode() == robot.safety.robot_mode,
            f"{dash.robot_mode()} {robot.safety.robot_mode}",
        )
        with bench.raises(LinkError, within=1.5):
            robot.motion.move_joints(_READY)
        dash.start(10.0)
        robot.safety.wait_until_clear(5.0)
    seconds = 0.0
    with bench.silence():
        begun = bench.now
        with bench.raises(LinkError, within=6.0):
            dash.robot_mode()
        seconds = bench.now - begun
    bench.check(seconds < 6.0, f"a question took {seconds:.1f} s")
    time.sleep(1.0)
    dash.robot_mode()
    dash.close()


@trial
def gripper(bench: Bench) -> None:
    """The gripper moves to the commanded position, and reports its position."""
    gripper, truth = bench.robot.gripper, bench.controller.gripper
    gripper.activate()
    for _ in range(2):
        position = bench.chance.randrange(256)
        status = gripper.move(position)
        bench.check(abs(gripper.position() - position) <= 2, f"commanded {position}, but it is at {gripper.position()}")
        bench.check(abs(status.position - position) <= 2, f"{status}")
        bench.check(not gripper.object_detected(), "an object is detected without an object")
    gripper.move(0)
    gripper.move(255, speed=1, wait=False)
    begun = bench.now
    with bench.raises(LinkTimeout, after=0.2, within=0.3):
        gripper.wait(0.2)
    gripper.stop()
    bench.check(bench.now - begun < 1.0, f"stop took {bench.now - begun:.2f} s")
    at = gripper.position()
    time.sleep(0.3)
    bench.check(abs(gripper.position() - at) < 12, "it moves after stop")
    bench.check(truth is not None, "no gripper")
    bench.reset()
    time.sleep(0.3)
    gripper.open()
    bench.check(gripper.position() < 10, f"open() leaves it at {gripper.position()}")


@trial
def a_slow_network(bench: Bench) -> None:
    """Texts sent in parts arrive whole, even if other texts are sent meanwhile; texts not sent in time fail."""
    route = bench.sim.network.route(bench.here, bench.there)
    before, signals = route.bandwidth, bench.controller.signals
    signals.digital_outputs = 0
    filler = "  # " + 200 * "x" + "\n"
    size = bench.chance.choice((200, 600, 1500))
    source = "def p():\n" + size * filler + "  set_digital_out(1, True)\nend\n"
    bench.robot.safety.wait_until_clear(2.0)
    route.bandwidth = 1e5 + 1e6 * bench.chance.random()
    outcomes = []
    script = bench.robot.script
    for send in (
        lambda: script.run(source, wait=20.0),
        lambda: script.run("sec s():\n set_flag(5, True)\nend", wait=20.0),
        lambda: script.send_line("set_digital_out(3, True)"),
    ):
        outcomes.append(bench.ended(send))
        time.sleep(0.01)
    for thread, _ in outcomes:
        bench.joined(thread, 30.0)
    route.bandwidth = before
    time.sleep(1.0)
    for number, (_, outcome) in enumerate(outcomes):
        is_refused = outcome and isinstance(outcome[0], LinkError)
        done = (signals.digital_outputs >> 1 & 1, bench.controller.flags[5], signals.digital_outputs >> 3 & 1)[number]
        bench.check(is_refused or bool(done), f"text {number} was sent but not executed: {outcome}")
        bench.check(outcome and outcome[-1] > 0.0, f"text {number}: {outcome}")
    bench.check(bench.controller.counters.refused_programs == 0, "the controller has refused a text")


@trial
def a_held_process(bench: Bench) -> None:
    """A process that was suspended does not command based on old states: it first handles the newer ones."""
    robot, chance = bench.robot, bench.chance
    robot.motion.move_joints(_READY, wait=True)
    how = chance.choice(("stop that is over", "stop that holds", "nothing"))
    at, seconds = bench.now + 0.3, 0.6 + chance.random()
    led = chance.choice((None, "jog", "servo"))
    bench.sim.at(at, bench.here.suspend)
    begun = bench.controller.time + at - bench.now
    if how != "nothing":
        bench.controller.schedule(f"protective_stop@{begun + 0.1:.6f}")
    if how == "stop that is over":
        bench.controller.schedule(f"clear@{begun + 0.3:.6f}")
    bench.sim.at(at + seconds, bench.here.resume)
    outcome: LinkError | None = None
    try:
        if led == "jog":
            with robot.motion.jog("joints", timeout=0.4) as jog:
                while bench.now < at + seconds + 0.3:
                    jog.move([0.1, 0, 0, 0, 0, 0])
                    time.sleep(0.02)
        elif led == "servo":
            with robot.motion.servo(watchdog=0.2) as servo:
                q = robot.realtime.wait(2.0).q_target
                while bench.now < at + seconds + 0.3:
                    servo.send(q)
                    time.sleep(0.01)
        else:
            while bench.now < at + 1e-3:
                time.sleep(0.0002)
            robot.motion.move_joints(_READY + 0.1, wait=10.0)
    except LinkError as error:
        outcome = error
    if how == "stop that holds":
        bench.check(outcome is not None, f"{led}: an active stop is not reported")
        bench.check(not bench.controller.is_running_program or led is not None, "a program was started during a stop")
        bench.controller.faults.clear()
    elif how == "nothing" and led is None:
        bench.check(outcome is None, f"a motion after a pause failed: {outcome!r}")
    robot.safety.wait_until_clear(10.0)
    time.sleep(1.0)
    bench.check(np.abs(robot.realtime.wait(2.0).qd_actual).max() < 0.02, "the arm moves")
    robot.motion.move_joints(_READY, wait=True)
