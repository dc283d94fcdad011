"""Controller and client before the call, with the arm at rest: in simulated time, or in separate processes."""

from __future__ import annotations

import ast
import contextlib
import os
import queue
import signal
import subprocess
import sys
import threading
import traceback
from pathlib import Path
from typing import Any, Protocol

from linkcore.simulated import Simulation
from tests.urlink.afterwards import client, controller
from tests.urlink.afterwards.table import FIRMWARES

__all__ = ["TIMEOUT", "Processes", "Rig", "Simulated"]

#: Time limit for an answer of an end, in s.
TIMEOUT = 100.0
_ROOT = Path(__file__).resolve().parents[3]
_MODULE = "tests.urlink.afterwards"


class Rig(Protocol):
    """Interface of a test to both ends, which have the names "controller" and "client"."""

    #: Duration of a suspended end or a silent network, in s: longer than a robot may be silent (`stale_after`).
    hold: float

    def ask(self, name: str, *arguments: float) -> Any:
        """Call a method of `controller.Reports`."""

    def write(self, line: str) -> None:
        """Send a line to the client."""

    def read(self) -> str:
        """Return the next line of the client."""

    def suspend(self, end: str) -> None:
        """Suspend an end, and return when all of its threads have stopped."""

    def resume(self, end: str) -> None: ...

    def kill(self, end: str) -> None: ...

    def network(self, state: str) -> None:
        """Switch the network "up" or "down"."""

    def close(self) -> None: ...


class Simulated:
    """Two computers in simulated time."""

    #: Longer than the time after which the controller does not catch up on the cycles in which it was suspended.
    hold = 6.0

    def __init__(self, sim: Simulation, firmware: str, row: str) -> None:
        self._sim = sim
        addresses = {"controller": "192.168.0.100", "client": "192.168.0.10"}
        self._ends = {name: sim.computer(name, address) for name, address in addresses.items()}
        self._said: queue.Queue[str] = queue.Queue()
        self._heard: queue.Queue[str] = queue.Queue()
        with sim.on(self._ends["controller"]):
            self._controller = controller.make(FIRMWARES[firmware], firmware, host="192.168.0.100", ports="standard")
            self._reports = controller.Reports(self._controller)
            self._controller.start()
        with sim.on(self._ends["client"]):
            threading.Thread(target=self._run, args=(row,), daemon=True, name="client").start()
        assert self.read() == "ready"

    def _run(self, row: str) -> None:
        try:
            client.program(row, "192.168.0.100", self._said.get, self._heard.put)
        except Exception:
            self._heard.put(traceback.format_exc())

    def ask(self, name: str, *arguments: float) -> Any:
        return getattr(self._reports, name)(*arguments)

    def write(self, line: str) -> None:
        self._said.put(line)

    def read(self) -> str:
        try:
            return self._heard.get(timeout=TIMEOUT)
        except queue.Empty:
            raise AssertionError(f"the client does not answer\n{self._sim.stacks()}") from None

    def suspend(self, end: str) -> None:
        self._ends[end].suspend()

    def resume(self, end: str) -> None:
        self._ends[end].resume()

    def kill(self, end: str) -> None:
        self._ends[end].kill()

    def network(self, state: str) -> None:
        change = self._sim.network.mend if state == "up" else self._sim.network.cut
        change(self._ends["client"], self._ends["controller"])

    def close(self) -> None:
        """Do nothing, because everything ends with the simulation."""


class Process:
    """Process that is controlled line by line."""

    def __init__(self, *command: str) -> None:
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=_ROOT)

    def read(self) -> str:
        """Return the next line that the process prints."""
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line, f"{self.process.args!r} has ended with {self.process.wait(TIMEOUT)}"
        return line.strip()

    def write(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self.process.kill()
            self.process.communicate()


class Processes:
    """Two processes in real time, with their own network if the test has to cut it."""

    hold = 5.0

    def __init__(self, firmware: str, row: str, *, is_alone: bool) -> None:
        self._block = contextlib.ExitStack()
        python = [sys.executable, "-u", "-m"]
        with self._block as block:
            unshared = ["unshare", "--net"] if is_alone else []
            shell = ["sh", "-c", 'ip link set lo up && exec "$@"', "sh"] if is_alone else []
            there = Process(*unshared, *shell, *python, f"{_MODULE}.controller", FIRMWARES[firmware], firmware)
            block.callback(there.close)
            self._inside = ["nsenter", f"--net=/proc/{there.process.pid}/ns/net"] if is_alone else []
            here = Process(*self._inside, *python, f"{_MODULE}.client", row, there.read())
            block.callback(here.close)
            self._ends = {"controller": there, "client": here}
            assert self.read() == "ready"
            self._block = block.pop_all()

    def ask(self, name: str, *arguments: float) -> Any:
        there = self._ends["controller"]
        there.write(" ".join(map(str, (name, *arguments))))
        return ast.literal_eval(there.read())

    def write(self, line: str) -> None:
        self._ends["client"].write(line)

    def read(self) -> str:
        return self._ends["client"].read()

    def _send(self, end: str, number: int) -> None:
        os.kill(self._ends[end].process.pid, number)

    def suspend(self, end: str) -> None:
        self._send(end, signal.SIGSTOP)
        os.waitpid(self._ends[end].process.pid, os.WUNTRACED)

    def resume(self, end: str) -> None:
        self._send(end, signal.SIGCONT)

    def kill(self, end: str) -> None:
        self._send(end, signal.SIGKILL)

    def network(self, state: str) -> None:
        subprocess.run([*self._inside, "ip", "link", "set", "lo", state], check=True, timeout=TIMEOUT)

    def close(self) -> None:
        self._block.close()
