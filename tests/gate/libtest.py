"""Results of test executables, read from the JSON lines of libtest.

libtest gives JSON and durations to nightly toolchains only. A test executable of a stable toolchain gives them if
RUSTC_BOOTSTRAP is in its environment. No compiler gets that variable.
"""
import json
import re
import threading
import time

from .command import Failed

OPTIONS = ["-Zunstable-options", "--format", "json", "--report-time", "--show-output"]


class Results:
    """Results of one executable, called `name`."""

    def __init__(self, name):
        self.name, self.lock = name, threading.Lock()
        self.durations, self.failures, self.left_out = [], [], []
        self.passed, self.started, self.suites, self.seconds = 0, {}, 0, 0.0
        self.other = []

    def line(self, line):
        begin = line.find('{ "type":')
        if begin >= 0:
            try:
                event = json.loads(line[begin:])
            except json.JSONDecodeError:
                self.other.append(line)
                return
            with self.lock:
                self.event(event)
            return
        if found := re.match(r"test result: \w+\. (\d+) passed; (\d+) failed", line):
            # Tests of the documentation print text.
            self.passed += int(found[1])
            self.suites += 1
            self.failures += [("a test of the documentation", "\n".join(self.other[-60:]))] * int(found[2])
        self.other = self.other[-199:] + [line]

    def event(self, event):
        kind, what = event.get("type"), event.get("event")
        if kind == "suite":
            self.suites += what != "started"
            if what == "started":
                self.started = {}
            return
        if kind != "test":
            return
        name = f"{self.name}::{event['name']}"
        if what == "started":
            self.started[name] = time.monotonic()
        elif what == "ignored":
            self.started.pop(name, None)
        elif what in ("ok", "failed"):
            self.started.pop(name, None)
            said = event.get("stdout", "")
            waited = sum(map(float, re.findall(r"^waited ([0-9.]+) s for processors$", said, re.MULTILINE)))
            self.durations.append((event.get("exec_time", 0.0) - waited, name))
            self.left_out += re.findall(r"^left out: .*", said, re.MULTILINE)
            if what == "ok":
                self.passed += 1
            else:
                self.failures.append((name, said))

    def running(self):
        """Tests that have begun and not ended, with their seconds so far."""
        now = time.monotonic()
        with self.lock:
            return [(name, now - since) for name, since in self.started.items()]

    def running_lines(self):
        return [f"  still running: {name} ({seconds:.0f} s)" for name, seconds in self.running()]

    def end(self, status):
        if self.failures:
            shown = [f"{name}\n{excerpt(said)}" for name, said in self.failures]
            raise Failed("\n".join(f"test {text}" for text in shown))
        if status != 0:
            raise Failed("\n".join([f"exit status {status}", *self.running_lines(), *self.other[-60:]]))
        if self.suites == 0:
            raise Failed(f"{self.name} ran no tests")


def excerpt(said, most=50):
    """The output of a failed test: its end, which has the panic, and the number of lines before it."""
    lines = said.rstrip().splitlines()
    hidden = [f"    … {len(lines) - most} lines before"] if len(lines) > most else []
    return "\n".join(hidden + [f"    {line}" for line in lines[-most:]])
