"""One command of a part: its output in a file, its time limit, and its processor time."""
import os
import pathlib
import signal
import subprocess
import threading
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]


class Failed(Exception):
    """A part failed. The message is short and complete."""


def processes_below(pid):
    """All descendants of a process, and the process itself, as they are now."""
    children = {}
    for entry in pathlib.Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                # The name of the command stands in parentheses, and may have spaces.
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
            except (OSError, IndexError, ValueError):
                continue
            children.setdefault(parent, []).append(int(entry.name))
    found = [pid]
    for process in found:
        found += children.get(process, [])
    return found


def threads_of(pid):
    """Each process below `pid` with its threads: name, state, and the function of the kernel in which it waits."""
    def read(path):
        try:
            return path.read_text(errors="replace").replace("\0", " ").strip()
        except OSError:
            return "?"

    lines = []
    for process in processes_below(pid):
        place = pathlib.Path(f"/proc/{process}")
        lines.append(f"  process {process}: {read(place / 'cmdline')[:160] or read(place / 'comm')}")
        try:
            threads = sorted((place / "task").iterdir(), key=lambda thread: int(thread.name))
        except OSError:
            continue
        for thread in threads[:24]:
            state = read(thread / "stat").rpartition(")")[2].split()[:1]
            lines.append(f"    {read(thread / 'comm')}: {''.join(state)} {read(thread / 'wchan')}")
        if len(threads) > 24:
            lines.append(f"    and {len(threads) - 24} more threads")
    return lines


def kill_below(pid):
    """Ends a process and all its descendants."""
    for process in processes_below(pid):
        try:
            os.kill(process, signal.SIGKILL)
        except OSError:
            pass


class Command:
    """A command with its environment. `reader`, if given, gets each line of the output.

    The command ends as a failure after `limit` seconds, or after `silence` seconds in which it neither printed nor used a
    processor.
    """

    def __init__(self, *words, env=None, reader=None, limit=2400, silence=600, niceness=0,
                 directory=ROOT):
        self.words, self.env, self.reader = [str(word) for word in words], env or {}, reader
        self.limit, self.silence, self.niceness, self.directory = limit, silence, niceness, directory
        self.seconds, self.tail = 0.0, []

    def run(self, log):
        """Runs the command and returns its processor seconds. The output goes to the file `log`."""
        # An entry of None removes the variable. A process group, not a session: a session of its own would have a share
        # of the processors of its own, and niceness would only count within it.
        env = {key: value for key, value in {**os.environ, **self.env}.items() if value is not None}
        self.log, self.last = log, time.monotonic()
        log.write(f"$ {' '.join(self.words)}\n")
        child = subprocess.Popen(self.words, cwd=self.directory, env=env, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                 stderr=subprocess.STDOUT, text=True, errors="replace", process_group=0)
        if self.niceness:
            try:
                os.setpriority(os.PRIO_PROCESS, child.pid, self.niceness)
            except PermissionError:
                pass
        reading = threading.Thread(target=self.read, args=(child.stdout,), daemon=True)
        reading.start()
        ended = {}

        def wait():
            _, ended["status"], ended["usage"] = os.wait4(child.pid, 0)

        waiting = threading.Thread(target=wait, daemon=True)
        waiting.start()
        begin, used, report = time.monotonic(), 0, None
        while waiting.is_alive():
            waiting.join(5)
            now = time.monotonic()
            if waiting.is_alive() and now - self.last > self.silence / 4:
                # A silent compiler is no hang.
                busy = sum(processor_ticks(process) for process in processes_below(child.pid))
                if busy > used + 50:
                    used, self.last = busy, max(self.last, now - self.silence / 2)
            quiet = now - self.last > self.silence
            if waiting.is_alive() and report is None and (quiet or now - begin > self.limit):
                why = f"no output and no work for {self.silence} s" if quiet else f"no end within {self.limit} s"
                report = [f"hangs: {why}: {' '.join(self.words)[:200]}", *self.running(), *threads_of(child.pid)]
                kill_below(child.pid)
        # A process that the command left behind may hold the pipe open.
        reading.join(10)
        child.returncode = os.waitstatus_to_exitcode(ended["status"])
        self.seconds = ended["usage"].ru_utime + ended["usage"].ru_stime
        if report is not None:
            raise Failed("\n".join(report + ["  last output:"] + [f"    {line}" for line in self.tail[-20:]]))
        if self.reader is not None:
            self.reader.end(child.returncode)
        elif child.returncode != 0:
            said = "\n".join(self.tail[-60:])
            raise Failed(f"exit status {child.returncode}: {' '.join(self.words)[:200]}\n{said}")

    def running(self):
        return self.reader.running_lines() if self.reader is not None else []

    def read(self, pipe):
        for line in pipe:
            self.last = time.monotonic()
            self.log.write(line)
            line = line.rstrip("\n")
            self.tail = self.tail[-199:] + [line]
            if self.reader is not None:
                self.reader.line(line)
        pipe.close()


def processor_ticks(pid):
    """Processor time of a process and its ended children, in ticks."""
    try:
        fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return sum(int(ticks) for ticks in fields[11:15])
    except (OSError, ValueError):
        return 0
