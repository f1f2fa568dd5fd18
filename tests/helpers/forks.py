"""Processes that begin with pixsim and its packages imported, but for Mitsuba: they are forked from
one that has done so.

A process of its own takes a second for the imports, which most tests of processes are not about.
"""

import functools
import gc
import importlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import CodeType

HANG_S = 600  # as in helpers.processes, which the first process does not find
IMPORTED = (
    "cli.commands",
    *(f"report.{name}" for name in ("run", "study", "compare", "lens")),
    "show.figures",
    "measure.datasheet",
)
COMMAND = "from pixsim.cli import command\ncommand()\n"
PIPES = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)


class Forked:
    """A forked process, the leader of its own process group, like `subprocess.Popen` with text
    streams.

    script : its lines
    words : its arguments
    """

    def __init__(
        self, script: str, words: list[str], folder: Path | str, environment: dict[str, str]
    ) -> None:
        self.returncode: int | None = None
        pipes = [os.pipe(), os.pipe()]
        self.stdout, self.stderr = (os.fdopen(reading) for reading, _ in pipes)
        self._connection, theirs = socket.socketpair()
        with theirs, open(os.devnull) as nothing:
            streams = [nothing.fileno(), *(writing for _, writing in pipes)]
            socket.send_fds(first_process()[0], [b"!"], [theirs.fileno(), *streams])
        for _, writing in pipes:
            os.close(writing)
        self._lines = self._connection.makefile("rw")
        self._lines.write(json.dumps([script, words, str(folder), environment]) + "\n")
        self._lines.flush()
        self.pid = int(self._lines.readline())

    def wait(self, longest_s: float = HANG_S) -> int:
        if self.returncode is None:
            if not select.select([self._connection], [], [], longest_s)[0]:
                raise subprocess.TimeoutExpired(str(self.pid), longest_s)
            self.returncode = int(self._lines.readline())
            self._lines.close(), self._connection.close()
        return self.returncode

    def poll(self) -> int | None:
        try:
            return self.wait(0.0)
        except subprocess.TimeoutExpired:
            return None

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def communicate(self, timeout: float = HANG_S) -> tuple[str, str]:
        """What it and its children have written, until all of them have closed the streams."""
        end, texts = time.monotonic() + timeout, {self.stdout: b"", self.stderr: b""}
        while streams := [each for each in texts if not each.closed]:
            ready = select.select(streams, [], [], max(end - time.monotonic(), 0.0))[0]
            if not ready:
                raise subprocess.TimeoutExpired(str(self.pid), timeout)
            for stream in ready:
                if part := os.read(stream.fileno(), 1 << 16):
                    texts[stream] += part
                else:
                    stream.close()
        self.wait(max(end - time.monotonic(), 0.0))
        return texts[self.stdout].decode(), texts[self.stderr].decode()


@functools.cache
def first_process() -> tuple[socket.socket, subprocess.Popen[bytes]]:
    """The process that the others are forked from, which ends with this one, and the connection to
    it.
    """
    ours, theirs = socket.socketpair()
    with theirs:
        # Its own streams are pipes, as those of the others are, which the objects of Python must
        # fit.
        line = [sys.executable, "-P", __file__, str(theirs.fileno())]
        return ours, subprocess.Popen(
            line, pass_fds=[theirs.fileno()], cwd="/", start_new_session=True, **PIPES
        )


def forked(control: socket.socket) -> tuple[CodeType, list[str]]:
    """Wait for requests; return the script and the words of one, in a process of its own."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    while True:
        got, (*descriptors,), _, _ = socket.recv_fds(control, 1, 4)
        if not got:
            os._exit(0)
        if os.fork():
            for each in descriptors:
                os.close(each)
            continue
        control.close()
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # this one waits for the process, its child
        connection, *streams = descriptors
        with os.fdopen(connection, "r+b", buffering=0) as lines:
            script, words, folder, environment = json.loads(
                b"".join(iter(functools.partial(lines.read, 1), b"\n"))
            )
            if child := os.fork():
                for each in (*streams, 0, 1, 2):
                    os.close(each)
                lines.write(b"%d\n" % child)
                _, status = os.waitpid(child, 0)
                lines.write(b"%d\n" % os.waitstatus_to_exitcode(status))
                os._exit(0)
        os.setsid()
        for number, each in enumerate(streams):
            os.dup2(each, number)
            os.close(each)
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(environment)
        return compile(script, "script.py", "exec"), words


if __name__ == "__main__":
    from pixsim.base.lazy import ignore_matplotlibrc

    ignore_matplotlibrc()
    for name in IMPORTED:
        importlib.import_module(f"pixsim.{name}")
    gc.freeze()
    code, sys.argv[1:] = forked(socket.socket(fileno=int(sys.argv[1])))
    exec(code)
