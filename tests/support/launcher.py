"""Starts of programs without the time that their imports take: they are made once, and each process is a fork.

Importing the service or Dask takes more than a second of processor time, which dozens of servers and workers would
each take again; the processes of fits and figures would import and cache more. What runs in the fork is the ``main`` of
the program, with arguments, environment and log of its own. The process from which it forks its workers is a fork, too,
which it uses once: a second one is started as usual. The processes of pytest that run tests share one launcher.
"""

import atexit
import fcntl
import gc
import json
import os
import queue
import selectors
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib import import_module
from multiprocessing import util
from pathlib import Path
from typing import Any, Literal, NoReturn

from tests.support.processes import short_folder

ROOT = Path(__file__).parents[2]

Program = Literal["dsbrdf_service", "dask"]
MAX_REQUEST_BYTES = 1 << 17
SHARED = "DSBRDF_TESTS_LAUNCHER"
"""Variable of the environment that names the socket of the launcher of services."""


class ForkedProcess:
    """What tests use of `subprocess.Popen`, for a process that the launcher has forked; it may end at any time."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._ended = threading.Event()
        self._code = 0

    def poll(self) -> int | None:
        return self._code if self._ended.is_set() else None

    def wait(self, timeout: float = 60.0) -> int:
        if not self._ended.wait(timeout):
            raise subprocess.TimeoutExpired(str(self.pid), timeout)
        return self._code

    def send_signal(self, number: int) -> None:
        if not self._ended.is_set():
            with suppress(ProcessLookupError):  # its end has not been reported yet
                os.kill(self.pid, number)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def _end(self, code: int) -> None:
        self._code = code
        self._ended.set()


class Launcher:
    """A connection to the process that has imported a program; the forks made for it end with it."""

    def __init__(self, path: str) -> None:
        self._lock = threading.Lock()
        self._started: queue.Queue[ForkedProcess | None] = queue.Queue()
        self._connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._connection.connect(path)
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()
        atexit.register(self._close)

    def launch(
        self,
        arguments: Sequence[str],
        environment: Mapping[str, str],
        log: Path,
        constants: Mapping[str, float] | None = None,
    ) -> ForkedProcess:
        """Fork a process that runs the program and appends what it prints to a log.

        `constants` of modules, by their dotted names, get other values: times that a test would have to wait for.
        """
        request = {"arguments": arguments, "environment": dict(environment), "constants": dict(constants or {})}
        request |= {"log": str(log), "cwd": str(Path.cwd())}
        with self._lock:
            self._connection.send(json.dumps(request).encode())
            process = self._started.get()
        if process is None:
            raise RuntimeError("the launcher has ended; what it printed says why")
        return process

    def _close(self) -> None:
        self._connection.shutdown(socket.SHUT_RDWR)
        self._listener.join()
        self._connection.close()

    def _listen(self) -> None:
        servers: dict[int, ForkedProcess] = {}
        while line := self._connection.recv(MAX_REQUEST_BYTES):
            match json.loads(line):
                case {"pid": pid, "code": code}:
                    servers.pop(pid)._end(code)
                case {"pid": pid}:
                    servers[pid] = ForkedProcess(pid)
                    self._started.put(servers[pid])
        self._started.put(None)


def start(program: Program) -> str:
    """Start a launcher, which ends with this process; return the path of its socket."""
    folder = short_folder()
    path = f"{folder.name}/launcher"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listening:
        listening.bind(path)
        listening.listen()
        command = [sys.executable, "-m", "tests.support.launcher", program, str(listening.fileno())]
        process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, pass_fds=[listening.fileno()])

    def end() -> None:
        process.communicate()
        folder.cleanup()

    atexit.register(end)
    return path


def share() -> None:
    """Start the launcher of services for this process and the ones that it starts."""
    os.environ[SHARED] = start("dsbrdf_service")


@cache
def launcher(program: Program) -> Launcher:
    """Return the connection of this process to the launcher of a program, which is started if none is shared."""
    return Launcher((program == "dsbrdf_service" and os.environ.get(SHARED)) or start(program))


def _serve_requests(program: str, listening: int) -> None:
    """Fork a process for each message of a connection; tell there which run and how they ended."""
    import_module(f"{program}.__main__")
    if program == "dask":
        for command in ("scheduler", "worker"):
            import_module(f"distributed.cli.dask_{command}")
        import_module("dsbrdf.engines.local")  # for what workers run
        import_module("dsbrdf.data.geometry").nodes_above_horizon()  # cached for all workers, as their server does it
    else:
        _warm_up()
    gc.freeze()  # a collection in a fork would write into all that it shares
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # it ends with its input, and servers may still be needed until then
    connections: dict[int, socket.socket] = {}
    running: dict[int, tuple[int, socket.socket]] = {}  # The key is the descriptor that becomes readable at the end.
    with selectors.DefaultSelector() as selector, socket.socket(fileno=listening) as listener:
        for source in (sys.stdin.fileno(), listening):
            selector.register(source, selectors.EVENT_READ)
        while True:
            for key, _ in selector.select():
                if key.fd == listening:
                    connection = listener.accept()[0]
                    connections[connection.fileno()] = connection
                    selector.register(connection.fileno(), selectors.EVENT_READ)
                elif key.fd in running:
                    selector.unregister(key.fd)
                    os.close(key.fd)
                    pid, connection = running.pop(key.fd)
                    _say(connection, pid=pid, code=os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
                elif request := key.fd in connections and connections[key.fd].recv(MAX_REQUEST_BYTES):
                    pid = os.fork() or _become(program, json.loads(request))
                    descriptor = os.pidfd_open(pid)
                    running[descriptor] = pid, connections[key.fd]
                    selector.register(descriptor, selectors.EVENT_READ)
                    _say(connections[key.fd], pid=pid)
                else:  # A connection or, with standard input, everything ends.
                    selector.unregister(key.fd)
                    ended = connections.pop(key.fd, None)
                    for pid, connection in running.values():
                        if ended in (connection, None):
                            os.kill(pid, signal.SIGKILL)
                    if ended is None:
                        return


def _warm_up() -> None:
    """Import and cache what each process of a fit or of a figure would by itself, in half of its time."""
    for module in ("figure", "backends.backend_agg", "backends.backend_svg"):
        import_module(f"matplotlib.{module}")
    measurement = import_module("tests.support.merl_files").glossy_plastic()
    library = import_module("dsbrdf")
    with warnings.catch_warnings(action="ignore"):  # Three iterations do not converge.
        library.decompose(library.fit(measurement, method="paper", n_lobes=1, em_iterations=3).model)
    _let_endless_fits_sleep()


def _let_endless_fits_sleep() -> None:
    """Let endless fits sleep instead of computing: a test looks at one for seconds, in which it would take a core."""
    local, endless = import_module("dsbrdf.engines.local"), import_module("tests.support.tasks").ENDLESS
    fit = local.fit_quietly

    def sleep_or_fit(measurement: object, options: Any, on_progress: Callable[[float], object]) -> object:
        while options.knots_deg == endless.knots_deg:
            time.sleep(60.0)
        return fit(measurement, options, on_progress)

    vars(local)["fit_quietly"] = sleep_or_fit


def _say(connection: socket.socket, **document: int) -> None:
    with suppress(ConnectionError):  # Who started a process may have ended before it.
        connection.send(json.dumps(document).encode())


def _become(program: str, request: dict[str, Any]) -> NoReturn:
    """Run a program in this process, as a fresh interpreter would."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    log = os.open(request["log"], os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    nothing = os.open(os.devnull, os.O_RDONLY)
    for source, target in ((nothing, 0), (log, 1), (log, 2)):
        os.dup2(source, target)
    os.closerange(3, 256)
    os.environ.clear()
    os.environ.update(request["environment"])
    tempfile.tempdir = None
    os.chdir(request["cwd"])
    if program == "dask":
        import_module("dask.config").refresh()  # it takes settings from the environment
    for name, value in request["constants"].items():
        module, _, constant = name.rpartition(".")
        assert constant in vars(import_module(module))
        vars(import_module(module))[constant] = value
    _prepare_fork_server()
    sys.argv = [program, *request["arguments"]]
    _leave(import_module(f"{program}.__main__").main)


def _leave(main: Callable[[], object]) -> NoReturn:
    """Run a main function and end the process as its interpreter would, but for taking its modules apart.

    Their memory is shared with the launcher; to write into all of it takes a third of a second.
    """
    try:
        code = main()
    except SystemExit as end:
        code = end.code
    except BaseException:
        traceback.print_exc()
        code = 1
    vars(threading)["_shutdown"]()  # waits for threads
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else 0)  # None, as a server of processes ends


def _prepare_fork_server() -> None:
    """Fork the process that becomes the server of this one's workers when it is asked for."""
    ours, its = socket.socketpair()
    pid = os.fork()
    if pid == 0:
        ours.close()
        _become_fork_server(its)
    its.close()
    start = util.spawnv_passfds

    def use_prepared(path: bytes, arguments: Sequence[str], descriptors: Sequence[int]) -> int:
        command = os.fsdecode(arguments[-1])
        if "forkserver" not in command or ours.fileno() < 0:
            return start(path, arguments, descriptors)
        request = {"command": command, "environment": dict(os.environ), "descriptors": list(descriptors)}
        socket.send_fds(ours, [json.dumps(request).encode()], descriptors)
        ours.close()
        return pid

    vars(util)["spawnv_passfds"] = use_prepared


def _become_fork_server(requests: socket.socket) -> NoReturn:
    """Run the command of a fork server in this process, if it comes before the one that it is for has ended."""
    Path("/proc/self/comm").write_text("forkserver")  # for who looks for it: the command line is not its own
    message, received, _, _ = socket.recv_fds(requests, 1 << 16, 8)
    while part := requests.recv(1 << 16):
        message += part
    requests.close()
    if not message:
        os._exit(0)
    request = json.loads(message)
    aside = [fcntl.fcntl(descriptor, fcntl.F_DUPFD, 256) for descriptor in received]
    os.closerange(3, 256)
    for descriptor, number in zip(aside, request["descriptors"], strict=True):
        os.dup2(descriptor, number)
        os.close(descriptor)
    os.environ.clear()
    os.environ.update(request["environment"])
    _leave(lambda: exec(request["command"]))


if __name__ == "__main__":
    _serve_requests(sys.argv[1], int(sys.argv[2]))
