"""A child process with limits of memory and time; one request after the other, JSON lines over stdin and stdout."""

import contextlib
import json
import os
import select
import subprocess
import time

import psutil

INTERVAL = 0.05  # s between two looks at a child
STALL = 4  # wall-clock seconds a CPU second of the limit


class Failed(Exception):
    """A child has no answer; the text is for a table: "out of memory", "over the time limit", or its last words."""


class Child:
    """``command`` as a process, until the end of the ``with`` block.

    Parameters
    ----------
    command : list of str
    log : pathlib.Path
        Where its standard error goes.
    memory : float
        Bytes of resident memory beyond which it is killed.
    seconds : float
        CPU seconds of one request beyond which it is killed; four times as many by the wall clock.
    environment : dict
        Added to this process' own.

    Raises
    ------
    Failed
        Of `ask`, after which the child is gone, or has answered that it failed.
    """

    def __init__(self, command, log, memory, seconds, environment=None):
        self.memory, self.seconds = memory, seconds
        log.parent.mkdir(parents=True, exist_ok=True)
        with open(log, "ab") as errors:
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                env=os.environ | (environment or {}),
                start_new_session=True,
            )
        self.watched = psutil.Process(self.process.pid)
        self.log, self.received = log, b""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.end()

    def end(self):
        """No process is left, whatever it is doing."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            with contextlib.suppress(OSError):  # closing flushes, to nobody
                pipe.close()

    def ask(self, request=None):
        """Send a request (the first answer comes without), return the answer as a dict."""
        if request is not None:
            try:
                self.process.stdin.write(json.dumps(request).encode() + b"\n")
                self.process.stdin.flush()
            except OSError:
                raise Failed(self.last_words()) from None
        reply = json.loads(self._line())
        if "failed" in reply:
            raise Failed(reply["failed"])
        return reply

    def _line(self):
        begin, cpu = time.monotonic(), self._spent()[1]
        while b"\n" not in self.received:
            if select.select([self.process.stdout], [], [], INTERVAL)[0]:
                part = os.read(self.process.stdout.fileno(), 65536)
                if not part:
                    raise Failed(self.last_words())
                self.received += part
                continue
            resident, spent = self._spent()
            if resident > self.memory:
                self.end()
                raise Failed("out of memory")
            if spent - cpu > self.seconds or time.monotonic() - begin > STALL * self.seconds:
                self.end()
                raise Failed("over the time limit")
        line, self.received = self.received.split(b"\n", 1)
        return line

    def _spent(self):
        """Resident bytes and CPU seconds."""
        try:
            with self.watched.oneshot():
                times = self.watched.cpu_times()
                return self.watched.memory_info().rss, times.user + times.system
        except psutil.Error:
            return 0, 0.0  # it has just ended; reading will tell

    def last_words(self):
        """How it ended: by which signal, or the last line of its standard error."""
        status = self.process.wait()
        if status < 0:
            return "out of memory" if status == -9 else f"killed by signal {-status}"
        lines = [line for line in self.log.read_text(errors="replace").splitlines() if line.strip()]
        return f"ended with status {status}: {lines[-1].strip()[:200] if lines else 'no message'}"
