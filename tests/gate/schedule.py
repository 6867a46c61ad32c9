"""Runs the parts of a ring, several at a time as far as their processors allow."""
import os
import sys
import threading
import time

from . import account
from .command import ROOT, Failed

PROGRESS = 60  # s between two lines about the parts that run


class Part:
    """A part of a ring: commands that run one after the other.

    `kind` is build, test or download. `needs` names the parts that must have passed before, `after` those that must have
    ended, if they run. `processors` is how many processors the part keeps busy; None means all. Parts with the same
    `lock` never run together. `left_out` is the reason why the part is left out.
    """

    def __init__(self, name, kind, *commands, needs=(), after=(), processors=1.0, lock=None, left_out=None):
        self.name, self.kind, self.commands, self.needs, self.after = name, kind, commands, needs, after
        self.processors = os.cpu_count() if processors is None else processors
        self.lock, self.left_out = lock, left_out
        self.outcome, self.wall, self.seconds, self.said, self.notes = None, 0.0, 0.0, "", []

    def results(self):
        # Commands may share a reader.
        readers = [command.reader for command in self.commands if command.reader is not None]
        return list({id(reader): reader for reader in readers}.values())

    def run(self):
        place = ROOT / "target/gate"
        begin = time.monotonic()
        with open(place / f"{self.name.replace(' ', '-')}.log", "w", buffering=1) as log:
            try:
                for command in self.commands:
                    try:
                        command.run(log)
                    finally:
                        self.seconds += getattr(command, "seconds", 0.0)
                self.outcome = "passed"
            except Failed as failed:
                self.outcome, self.said = "FAILED", str(failed)
            except Exception as error:  # The gate itself is wrong: a red part, not a silent one.
                self.outcome, self.said = "FAILED", f"{type(error).__name__}: {error}"
        self.wall = time.monotonic() - begin
        said = [line for command in self.commands for line in getattr(command, "tail", [])]
        self.notes = [line for line in said if line.startswith("left out: ")]
        if self.outcome == "passed" and self.notes and not self.results():
            self.outcome = self.notes[0]


class Schedule:
    """Runs parts in the order of their list. A part starts once what it needs has passed and processors are free."""

    def __init__(self, parts):
        self.parts, self.changed = parts, threading.Condition()
        self.busy, self.locked, self.begin = 0.0, set(), time.monotonic()

    def say(self, text):
        print(f"[{time.monotonic() - self.begin:5.0f} s] {text}", flush=True)

    def run(self):
        busy, stolen = account.processors()
        waiting, running, downloads, spoke = list(self.parts), [], 0.0, time.monotonic()
        looked = spoke
        for part in [part for part in waiting if part.left_out]:
            part.outcome = f"left out: {part.left_out}"
            waiting.remove(part)
        while waiting or running:
            with self.changed:
                # Time in which nothing but downloads ran.
                now = time.monotonic()
                downloads += now - looked if running and all(part.kind == "download" for part in running) else 0.0
                looked = now
                for part in [part for part in running if part.outcome is not None]:
                    running.remove(part)
                    self.ended(part)
                for part in list(waiting):
                    state = self.state(part)
                    if state == "lost":
                        part.outcome = "not run: a part that it needs did not pass"
                        waiting.remove(part)
                    elif state == "ready":
                        waiting.remove(part)
                        running.append(part)
                        self.busy += part.processors
                        self.locked.add(part.lock)
                        self.say(f"{part.name} …")
                        threading.Thread(target=self.work, args=(part,), daemon=True).start()
                if running and not any(part.outcome is not None for part in running):
                    self.changed.wait(5)
            if time.monotonic() - spoke > PROGRESS:
                spoke = time.monotonic()
                for part in running:
                    state = ", ".join([result.progress() for result in part.results()] or ["runs"])
                    self.say(f"{part.name}: {state}")
        after = account.processors()
        return {
            "wall": time.monotonic() - self.begin,
            "busy": after[0] - busy,
            "stolen": after[1] - stolen,
            "downloads": downloads,
        }

    def work(self, part):
        part.run()
        with self.changed:
            self.changed.notify_all()

    def ended(self, part):
        self.busy -= part.processors
        self.locked.discard(part.lock)
        counted = "".join(f", {result.progress()}" for result in part.results())
        self.say(f"{part.name}: {part.outcome} after {part.wall:.0f} s{counted}")
        if part.said:
            print(part.said, file=sys.stdout, flush=True)

    def state(self, part):
        """Whether a part is ready, has to wait, or is lost because a part that it needs did not pass."""
        by_name = {other.name: other for other in self.parts}
        needed = [by_name[name] for name in part.needs if name in by_name]
        outcomes = [other.outcome for other in needed]
        # What needs a part that is left out says itself that it is left out.
        if any(outcome is not None and not outcome.startswith(("passed", "left out")) for outcome in outcomes):
            return "lost"
        outcomes += [by_name[name].outcome for name in part.after if name in by_name]
        if any(outcome is None for outcome in outcomes) or (part.lock is not None and part.lock in self.locked):
            return "waits"
        # A part that waits for clocks runs beside a build that uses all processors.
        free = os.cpu_count() + 0.6 - self.busy
        return "ready" if part.processors <= free or self.busy == 0 else "waits"
