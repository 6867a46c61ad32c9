"""Test executables: found in the messages of cargo, run with the environment that cargo gives them."""
import json
import os
from concurrent.futures import ThreadPoolExecutor

from . import libtest
from .command import Command, Failed


class Messages:
    """Reader of `cargo test --no-run --message-format json-render-diagnostics`: the executables of all tests."""

    def __init__(self):
        self.found, self.said = {}, []

    def line(self, line):
        if not line.startswith("{"):
            self.said.append(line)
            return
        message = json.loads(line)
        if message.get("reason") == "compiler-artifact" and message.get("executable") and message["profile"]["test"]:
            # path+file:///…/drivers/can#mrroc-can@0.1.0, or path+file:///…/mrroc#0.1.0
            place, _, version = message["package_id"].partition("#")
            package = version.partition("@")[0] if "@" in version else place.rsplit("/", 1)[-1]
            target = message["target"]
            name = package if target["kind"] != ["test"] else f"{package}/{target['name']}"
            self.found[message["executable"]] = (name, message["manifest_path"])

    def running_lines(self):
        return []

    def progress(self):
        return f"{len(self.found)} test executables"

    def end(self, status):
        if status != 0:
            raise Failed("\n".join(self.said[-80:]))


class Executables:
    """Runs test executables as one command of a part. `chosen` selects them by the name of crate or target."""

    def __init__(self, messages, chosen, threads, at_once=1, only="", env=None, limit=2400, niceness=0,
                 ignored=False):
        self.messages, self.chosen, self.threads, self.at_once = messages, chosen, threads, at_once
        self.only, self.env, self.limit, self.niceness, self.ignored = only, env or {}, limit, niceness, ignored
        self.reader, self.seconds, self.tail = Merged(), 0.0, []

    def run(self, log):
        found = [(name, path, manifest) for path, (name, manifest) in self.messages.found.items() if self.chosen(name)]
        if not found:
            raise Failed("no test executable")
        # The largest first.
        found.sort(key=lambda item: -os.path.getsize(item[1]))
        with ThreadPoolExecutor(self.at_once) as pool:
            failures = [said for said in pool.map(lambda item: self.one(log, *item), found) if said]
        self.seconds = sum(result.seconds for result in self.reader.results)
        if self.only and not self.reader.durations():
            failures.append(f"no test has {self.only} in its name")
        if failures:
            raise Failed("\n".join(failures))

    def one(self, log, name, path, manifest):
        results = libtest.Results(name)
        self.reader.results.append(results)
        directory = os.path.dirname(manifest)
        env = {
            "CARGO": "cargo",
            "CARGO_MANIFEST_DIR": directory,
            "CARGO_PKG_NAME": name,
            "RUSTC_BOOTSTRAP": "1",
            "RUST_TEST_THREADS": str(self.threads),
            "MRROC_BUILT": "1",
            **self.env,
        }
        filters = ["--include-ignored"] * self.ignored + [self.only] * bool(self.only)
        command = Command(path, *libtest.OPTIONS, *filters, env=env, reader=results, limit=self.limit,
                          niceness=self.niceness, directory=directory)
        try:
            command.run(log)
        except Failed as failed:
            return str(failed)
        finally:
            results.seconds = getattr(command, "seconds", 0.0)
        return None


class Merged:
    """Results of several executables."""

    def __init__(self):
        self.results = []

    def durations(self):
        return [item for result in self.results for item in result.durations]

    def passed(self):
        return sum(result.passed for result in self.results)

    def failed(self):
        return sum(len(result.failures) for result in self.results)

    def left_out(self):
        return [line for result in self.results for line in result.left_out]

    def progress(self):
        running = max(((seconds, name) for result in self.results for name, seconds in result.running()), default=None)
        said = f"{self.passed()} passed" + (f", {self.failed()} failed" if self.failed() else "")
        return said + (f", {running[1]} since {running[0]:.0f} s" if running and running[0] > 20 else "")
