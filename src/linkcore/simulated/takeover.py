"""Function `simulated_time`: a block in which time, threads and sockets are simulated for all code."""

from __future__ import annotations

import contextlib
import gc
import importlib
import logging
import operator
import os
import queue
import random
import re
import select
import selectors
import socket
import sys
import threading
import time
from _thread import get_ident
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import thread as _pool
from functools import partial
from types import ModuleType
from typing import Any

from ..errors import BadValue, LocalError
from ..names import StrictAttributes
from . import primitives
from .network import Computer, Network, Route
from .preemption import Preemption, is_importing
from .scheduler import STEP, Scheduler, current, install, installed
from .sockets import Poll, Selector, Socket, Sockets

if sys.platform != "win32":
    import fcntl

#: Calendar time at which a simulation begins, in s since 1970: 2026-01-01.
_EPOCH = 1767225600.0

#: Names of other Linux clocks that count the seconds since an arbitrary start.
_OF_LINUX = ("CLOCK_BOOTTIME", "CLOCK_MONOTONIC_RAW")

#: Modules in which nothing is replaced: modules that the simulation uses, modules of the interpreter, and modules that
#: never wait.
_KEPT = (
    "_thread",
    "importlib",
    "_frozen_importlib",
    "linkcore.simulated",
    "numpy",
    "_pytest.timing",
    "pytest_timeout",
    "xdist",
    "execnet",
)

#: C modules, or modules with their own locks, to import before the first simulation. They store objects during their
#: import. If they were imported inside a simulation, the first run in a process would differ from the next run.
_BEFORE = ("asyncio", "concurrent.futures.thread", "linkcore.clock", "multiprocessing.process", "numpy.random")

#: Faults of a computer, and their text form.
_OF_COMPUTERS = ("suspend", "resume", "hold", "release", "kill", "power_off", "power_on")
_FAULT = re.compile(r"(\w+)=([\w.-]+)@(\d+(?:\.\d*)?)")

#: Name of a module -> number of its names, and the names that might refer to replaced objects. These are names that
#: referred to one, and names equal to the name of such an object, because another object might temporarily be in its
#: place. Searching all names of all modules for each block would take most of the time of a short block.
_names: dict[str, tuple[int, tuple[str, ...]]] = {}


class Simulation(StrictAttributes):
    """Object that controls a `simulated_time` block, and shows its state.

    Attributes:
        network: Computers, and the connections between them.
        here: Computer on which the block runs.
    """

    def __init__(self, scheduler: Scheduler, network: Network, here: Computer, sockets: Sockets) -> None:
        self.network = network
        self.here = here
        self._scheduler = scheduler
        self._sockets = sockets

    @property
    def now(self) -> float:
        """Simulated time since the block began, in s."""
        return self._scheduler.now

    @property
    def trace(self) -> int:
        """Checksum of all steps so far. It is equal for two runs with the same steps."""
        return self._scheduler.trace

    @property
    def steps(self) -> int:
        """Number of times that a thread has passed a lock, a queue, a socket or a clock."""
        return self._scheduler.steps

    @property
    def random(self) -> random.Random:
        """Random numbers that depend on the seed."""
        return self._scheduler.random

    @property
    def open_sockets(self) -> int:
        """Number of open sockets, on all computers."""
        return self._sockets.count

    @property
    def threads(self) -> list[str]:
        """Names of the threads that have not ended, without the thread of the block."""
        return [task.name for task in self._scheduler.tasks[1:] if not task.is_over]

    def computer(self, name: str, address: str) -> Computer:
        """Add a computer with its own name and IPv4 address."""
        return self.network.add(name, address)

    @contextlib.contextmanager
    def on(self, computer: Computer) -> Iterator[None]:
        """Run a block as a program of another computer: its sockets and threads belong to this computer."""
        task = self._scheduler.running
        before, task.computer = task.computer, computer
        try:
            yield
        finally:
            task.computer = before

    def at(self, seconds: float, call: Callable[[], object]) -> None:
        """Call a function, such as `computer.suspend`, at a simulated time, in its own thread.

        The function may wait. It also runs while the computer of the caller is suspended. If it raises an exception,
        the block gets this exception.
        """
        scheduler, computer = self._scheduler, self._scheduler.running.computer

        def run() -> None:
            try:
                call()
            except Exception as error:
                scheduler.interrupt(error)

        thread = threading.Thread(target=run, name=f"call at {seconds:g} s", daemon=True)
        start = partial(primitives.start_on, scheduler, thread, computer, is_never_held=True)
        scheduler.call_at(seconds, start)

    def schedule(self, *faults: str) -> None:
        """Schedule faults of computers or cables: `schedule("cut=robot@5", "mend=robot@5.5")`.

        Each text is `NAME=COMPUTER@SECONDS`, in seconds since the block began.

        Faults of the cable between that computer and the computer of the block:

        - `cut`: every packet is lost
        - `cut_to`, `cut_from`: packets to the computer, or from it, are lost
        - `mend`: packets arrive again
        - `reset`: every connection is reset at both ends

        Faults of the computer:

        - `suspend`, `resume`: its program is suspended, but its kernel keeps running
        - `hold`, `release`: a function in C holds the interpreter's lock of its program
        - `kill`: its program is killed
        - `power_off`, `power_on`: it has no power

        Args:
            faults: Texts of the faults.

        Raises:
            BadValue: If there is no such fault, no such computer, or no such time.
        """
        for text in faults:
            match = _FAULT.fullmatch(text)
            if match is None:
                raise BadValue(f"invalid fault {text!r}; expected NAME=COMPUTER@SECONDS, such as 'cut=robot@5'")
            name, computer, seconds = match.groups()
            if computer not in self.network.computers:
                known = ", ".join(self.network.computers)
                raise BadValue(f"{text!r}: no computer is called {computer!r}; expected one of {known}")
            self.at(float(seconds), self._fault(name, self.network.computers[computer], text))

    def _fault(self, name: str, there: Computer, text: str) -> Callable[[], object]:
        network, here = self.network, self.here
        of_cables: dict[str, Callable[[], object]] = {
            "cut": lambda: network.cut(here, there),
            "cut_to": lambda: network.silence(here, there),
            "cut_from": lambda: network.silence(there, here),
            "mend": lambda: network.mend(here, there),
            "reset": lambda: network.reset(here, there),
        }
        if name in of_cables:
            return of_cables[name]
        if name not in _OF_COMPUTERS:
            known = ", ".join([*of_cables, *_OF_COMPUTERS])
            raise BadValue(f"{text!r}: no fault is called {name!r}; expected one of {known}")
        call: Callable[[], object] = getattr(there, name)
        return call

    def preempt(self, *packages: str) -> None:
        """Let threads switch between two lines of these packages or modules, too.

        This finds data races in code without a lock, queue, socket or clock. An example is
        `sim.preempt("my_cell", "urlink")`. A call without a name ends it. Use `at` to begin and end it at a simulated
        time. With the whole library, a program takes 5 to 15 times as long. The seed selects the functions in which
        threads yield, so more seeds test more functions.

        Threads do not yield in calls from a module that has held a `threading.Lock` since its import, because that is a
        real lock. A debugger, or coverage with `sys.settrace`, does not see the block in the meantime.

        Args:
            packages: Names of packages or modules.
        """
        self._scheduler.trace_lines(Preemption(self._scheduler, packages, sys.modules).trace if packages else None)

    def stacks(self) -> str:
        """Return the stack of every thread, as text."""
        return self._scheduler.stacks()


@contextlib.contextmanager
def simulated_time(
    seed: int = 0, *, limit: float = 86400.0, latency: float = 1e-4, jitter: float = 5e-5
) -> Iterator[Simulation]:
    """Run a block in simulated time, on a clock that jumps from one event to the next.

    `seed` decides the order of the threads. In the block, `time`, `threading`, `queue`, `concurrent.futures`, `socket`,
    `select`, `selectors` and asyncio are simulated, for every module that uses them. Threads that were already running
    do not take part and use real time.

    Args:
        seed: Seed of the run. The same seed gives the same run.
        limit: Simulated time after which the block gets `TimeLimit`, in s.
        latency: Time that a packet takes between two computers, in s.
        jitter: Maximum additional time of a packet, in s.

    Raises:
        Deadlock: If every thread waits for another one, without a deadline.
        TimeLimit: If the simulated time exceeds `limit`.
        LocalError: If time is already simulated.
    """
    if current() is not None:
        raise LocalError("time is already simulated; do not nest simulated_time blocks")
    for name in _BEFORE:
        importlib.import_module(name)
    scheduler = Scheduler(seed, limit)
    network = Network(scheduler, Route(latency, jitter))
    here = network.add("here", "192.168.0.1")
    sockets = Sockets(scheduler, network)
    numbers = random.getstate()
    of_pools: Any = _pool._threads_queues
    pooled = list(of_pools)
    collects = gc.isenabled()
    gc.disable()  # finalizers would be called at different steps in every run
    scheduler.adopt("main", here)
    put_back = _take_over(_replacements(sockets))
    install(scheduler)
    random.seed(seed)
    try:
        yield Simulation(scheduler, network, here, sockets)
    finally:
        # `concurrent.futures` would log a critical error when the idle threads of a pool are ended.
        of_futures = logging.getLogger("concurrent.futures")
        was_disabled, of_futures.disabled = of_futures.disabled, True
        scheduler.end()
        of_futures.disabled = was_disabled
        install(None)
        put_back()
        # At exit, the interpreter joins the threads of pools. This works only for real threads.
        for thread in list(of_pools):
            if thread not in pooled:
                del of_pools[thread]
        random.setstate(numbers)
        if collects:
            gc.enable()


def _replacements(sockets: Sockets) -> list[tuple[object, object]]:
    """Return pairs of a replaced object of the standard library and its replacement."""
    scheduler = sockets.scheduler
    # Use a separate generator, so that a program that requests more random bytes does not change the order of the
    # threads.
    chance = random.Random(scheduler.random.random())
    sleep, select_, getaddrinfo, urandom = time.sleep, select.select, socket.getaddrinfo, os.urandom
    getpid = os.getpid
    of_library: Any = sys.modules["linkcore.clock"]
    new_event_loop: Any = sys.modules["asyncio"].new_event_loop
    selector_loop: Any = sys.modules["asyncio"].SelectorEventLoop
    # The handle class of `call_soon_threadsafe`. Since CPython 3.14, it has a lock for threads that run in parallel.
    handle: Any = vars(sys.modules["asyncio.events"]).get("_ThreadSafeHandle", type("Handle", (), {}))

    task: Any = sys.modules["asyncio.tasks"].Task
    numbered = {"__init__": primitives.numbering(task.__init__), "__hash__": primitives.hash_}

    def clock(real: Callable[[], Any], epoch: float, scale: int) -> Callable[[], Any]:
        def read() -> Any:
            # A thread reads the clock several times for each packet, so the body of `current` is repeated here.
            scheduler = installed[0]
            if scheduler is None or scheduler.ident != get_ident():
                return real()
            scheduler.now += STEP
            computer = scheduler.running.computer
            seconds = epoch + computer.offset + scheduler.now * computer.rate
            if epoch:
                seconds += computer.jumped
            return int(seconds * scale) if scale else seconds

        return read

    since_start, since_1970 = clock(time.monotonic, 0.0, 0), clock(time.time, _EPOCH, 0)

    def sleep_(seconds: float) -> None:
        scheduler = current()
        if scheduler is None:
            sleep(seconds)
        elif seconds < 0:
            raise ValueError("sleep length must be non-negative")
        elif seconds == 0:
            scheduler.yield_()
        else:
            scheduler.wait(scheduler.deadline(seconds))

    def choose(simulated: Callable[..., Any], real: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *args, **named: (real if current() is None else simulated)(*args, **named)

    def lock(simulated: Callable[[], Any], real: Callable[[], Any]) -> Callable[[], Any]:
        # A lock of a module or class is a real one, whether the module was imported before or not.
        return lambda: (real if current() is None or is_importing() else simulated)()

    def new_socket(family: int = -1, type: int = -1, proto: int = -1, fileno: int | None = None) -> Any:
        return Socket(sockets, family, type, proto)

    of_system: list[tuple[object, object]] = []
    if sys.platform != "win32":
        gettime, ioctl = time.clock_gettime, fcntl.ioctl
        # The other clocks count processor time.
        clocks = {time.CLOCK_MONOTONIC: since_start, time.CLOCK_REALTIME: since_1970}
        clocks |= {which: since_start for name in _OF_LINUX if (which := getattr(time, name, None)) is not None}

        def gettime_(which: int) -> float:
            read = None if current() is None else clocks.get(which)
            return gettime(which) if read is None else read()

        def ioctl_(fd: Any, request: int, arg: Any = 0, mutate: bool = True) -> Any:
            found = sockets.find(fd)
            if isinstance(found, Socket) and found._end is not None:
                return found._end.unacknowledged.to_bytes(4, sys.byteorder)
            return ioctl(fd, request, arg, mutate)

        of_system = [
            (gettime, gettime_),
            (ioctl, choose(ioctl_, ioctl)),
            (select.poll, choose(lambda: Poll(sockets), select.poll)),
        ]

    return [
        *of_system,
        (of_library.read, clock(of_library.read, 0.0, 0)),
        (time.monotonic, clock(time.monotonic, 0.0, 0)),
        (time.perf_counter, clock(time.perf_counter, 0.0, 0)),
        (time.time, clock(time.time, _EPOCH, 0)),
        (time.monotonic_ns, clock(time.monotonic_ns, 0.0, 10**9)),
        (time.perf_counter_ns, clock(time.perf_counter_ns, 0.0, 10**9)),
        (time.time_ns, clock(time.time_ns, _EPOCH, 10**9)),
        (sleep, sleep_),
        (getpid, choose(lambda: sockets.computer().pid, getpid)),
        (threading.Lock, lock(primitives.Lock, threading.Lock)),
        (threading._allocate_lock, lock(primitives.Lock, threading._allocate_lock)),  # type: ignore[attr-defined]
        (threading.RLock, lock(primitives.RLock, threading.RLock)),
        (threading.Semaphore, primitives.Semaphore),
        (queue.SimpleQueue, primitives.SimpleQueue),
        (_pool._global_shutdown_lock, primitives.Lock()),
        # The default loop of Windows waits for completions in the kernel, which does not know simulated sockets.
        (new_event_loop, choose(selector_loop, new_event_loop)),
        (handle, type("Handle", handle.__bases__, {})),
        (task, type("Task", (task,), numbered)),
        (socket.socket, choose(new_socket, socket.socket)),
        (socket.socketpair, choose(sockets.pair, socket.socketpair)),
        (getaddrinfo, choose(sockets.addresses, getaddrinfo)),
        (select_, choose(sockets.select, select_)),
        (selectors.DefaultSelector, choose(lambda: Selector(sockets), selectors.DefaultSelector)),
        (urandom, choose(lambda size: urandom(size) if is_importing() else chance.randbytes(size), urandom)),
    ]


class _Look:
    """Snapshot of `sys.modules`.

    Attributes:
        values, modules: All values, which can be any object, and the modules among them.
        sizes: Number of names in each module.
        places: Names that might refer to replaced objects, each with its module.
    """

    def __init__(self, replacements: list[tuple[object, object]]) -> None:
        self.values: list[object] = list(sys.modules.values())
        named = {name: module for name, module in list(sys.modules.items()) if isinstance(module, ModuleType)}
        self.modules = list(named.values())
        self.sizes = list(map(len, map(vars, self.modules)))
        by_identity = {id(real) for real, _ in replacements}
        called = {getattr(real, "__name__", None) for real, _ in replacements}
        self.places: list[tuple[ModuleType, str]] = []
        for (name, module), size in zip(named.items(), self.sizes, strict=True):
            if name.startswith(_KEPT):
                continue
            count, names = _names.get(name, (0, ()))
            if count != size:
                held = list(vars(module).items())
                names = tuple(key for key, value in held if key in called or id(value) in by_identity)
                _names[name] = size, names
            self.places += [(module, name) for name in names]

    @property
    def is_current(self) -> bool:
        """Whether the modules are unchanged, and each still has the same number of names."""
        values = list(sys.modules.values())
        return (
            len(values) == len(self.values)
            and all(map(operator.is_, values, self.values))
            and list(map(len, map(vars, self.modules))) == self.sizes
        )


#: Latest snapshot. Most blocks begin and end with the same modules as the previous block.
_last: list[_Look] = []


def _take_over(replacements: list[tuple[object, object]]) -> Callable[[], None]:
    """Replace objects in all modules that refer to them by name; return an undo function."""
    by_identity = {id(real): simulated for real, simulated in replacements}
    if not (_last and _last[0].is_current):
        _last[:] = [_Look(replacements)]
    look = _last[0]
    done: list[tuple[ModuleType, str, object]] = []
    for module, attribute in look.places:
        value = vars(module).get(attribute)
        if id(value) in by_identity:
            done.append((module, attribute, value))
            setattr(module, attribute, by_identity[id(value)])
    # Replace the methods of the class itself, so that derived classes use them too.
    kept = {name: getattr(threading.Thread, name) for name in primitives.METHODS}
    for name, method in primitives.METHODS.items():
        setattr(threading.Thread, name, method)
    # Do not undo this: sets find threads of the block by their hash even afterwards.
    threading.Thread.__hash__ = primitives.hash_  # type: ignore[assignment]

    def put_back() -> None:
        for name, method in kept.items():
            setattr(threading.Thread, name, method)
        replaced: Mapping[int, object] = {id(simulated): real for real, simulated in replacements}
        for module, attribute, value in done:
            setattr(module, attribute, value)
        if look.is_current:
            return
        # Modules that were imported in the block refer to the simulated objects.
        sizes = dict(zip(map(id, look.modules), look.sizes, strict=True))
        for name, module in list(sys.modules.items()):
            if (
                isinstance(module, ModuleType)
                and len(vars(module)) != sizes.get(id(module))
                and not name.startswith("linkcore.simulated")
            ):
                for attribute, value in list(vars(module).items()):
                    if id(value) in replaced:
                        setattr(module, attribute, replaced[id(value)])

    return put_back
