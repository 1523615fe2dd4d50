"""A Dask cluster whose scheduler and workers are processes of their own, to be killed and started again."""

import os
import signal
from pathlib import Path

from tests.support.launcher import ForkedProcess, launcher
from tests.support.processes import alive, children, forked, free_port


class DaskCluster:
    """One scheduler, at an address that stays, and its workers."""

    def __init__(self, folder: Path, **environment: str) -> None:
        self._environment = environment
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self._port = free_port()
        self.address = f"tcp://127.0.0.1:{self._port}"
        self.scheduler: ForkedProcess | None = None
        self.workers: list[ForkedProcess] = []

    def start_scheduler(self) -> None:
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", str(self._port))

    def kill_scheduler(self) -> None:
        assert self.scheduler is not None
        _kill(self.scheduler)

    def add_worker(self, *flags: str, nanny: bool = False) -> ForkedProcess:
        """Start a worker of one thread, by default as fits need it: without a nanny."""
        flags = flags if nanny else ("--no-nanny", *flags)
        place = ("--host", "127.0.0.1", "--local-directory", str(self.folder))
        self.workers.append(self._start("worker", self.address, "--nthreads", "1", *place, *flags))
        return self.workers[-1]

    def kill_worker(self, worker: ForkedProcess) -> None:
        _kill(worker)
        self.workers.remove(worker)

    def fitting(self) -> list[int]:
        return [pid for worker in self.workers for pid in forked(worker.pid)]

    def close(self) -> None:
        for process in (*self.workers, self.scheduler):
            if process is not None:
                _kill(process)

    def log(self) -> str:
        return (self.folder / "log").read_text()

    def _start(self, kind: str, *flags: str) -> ForkedProcess:
        # An idle cluster would spend a fiftieth of a core on a profile of its own calls.
        quiet = {"DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False"}
        environment = {**os.environ, **quiet, "TMPDIR": str(self.folder), **self._environment}
        return launcher("dask").launch([kind, "--no-dashboard", *flags], environment, self.folder / "log")


def _kill(process: ForkedProcess) -> None:
    """Kill a process and, where it is a nanny, the worker that it has started."""
    offspring = children(process.pid)
    process.kill()
    process.wait()
    for pid in offspring:
        if alive(pid):
            os.kill(pid, signal.SIGKILL)
