"""The long ring, and the page with its results.

Each part of the ring writes its row of the page. The page names the commit that each row judges. `tests/run` warns if the
code changed after that commit, and does not fail.
"""
import datetime
import os
import re
import subprocess

from .command import ROOT, Command
from .executables import Executables, Messages
from .schedule import Part

PAGE = ROOT / "book/src/long-tests.md"
JUDGED = ["drivers", "servo", "controller", "hil", "mrroc", "tools", "console"]
ROW = re.compile(r"^\| `([a-z0-9-]+)` \| (.*) \| (.*) \| (.*) \| (.*) \| (.*) \|$")
FUZZ_SECONDS = 600


def git(*words):
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else None


def parts(only, seed):
    messages = Messages()

    def soak(cell, hours):
        words = ["cargo", "bench", "--locked", "-p", "mrroc-tests", "--bench", "soak", "--", cell, "--hours", hours]
        return Part(f"soak-{cell}", "test", Command(*words, "--seed", seed, limit=7200), lock="target", processors=2)

    def recording(cell, hours):
        words = ["cargo", "bench", "--locked", "-p", "mrroc-tests", "--bench", "recording", "--", cell, "--hours", hours]
        return Part(f"recording-{cell}", "test", Command(*words, limit=7200), lock="target", processors=2)

    def tests(name, chosen, only, **env):
        executables = Executables(messages, chosen=chosen.__eq__, only=only, threads=os.cpu_count(), limit=14_400, env=env)
        return Part(name, "test", executables, needs=["build"], processors=2)

    build = ["cargo", "test", "--workspace", "--release", "--locked", "--no-run"]
    # Each combination gives other features to packages of the registry, which are then checked again.
    clippy = ["cargo", "clippy", "--locked", "--quiet", "-p", "mrroc", "--no-default-features", "--features"]
    each = ["", "command-line", "pages", "recording"]
    features = [Command(*clippy, feature, "--", "-D", "warnings") for feature in each]
    tries = Executables(messages, chosen="mrroc-tests/clock".__eq__, only="_20", threads=1, limit=14_400, ignored=True)
    return [
        Part("build", "build", Command(*build, "--message-format", "json-render-diagnostics", reader=messages),
             Command("cargo", "build", "--workspace", "--release", "--locked", "--quiet", "--bins", "--examples"),
             lock="target", processors=2),
        soak("irb6", 24),
        soak("lab", 4),
        recording("irb6", 8),
        recording("lab", 1),
        tests("seeds", "mrroc-tests/system", only or "random::", MRROC_RANDOM_SEED=str(seed), MRROC_RANDOM_TIMES="48"),
        tests("grids", "mrroc-tests/system", only or "each_row_of_the_grids", MRROC_RANDOM_TIMES="1000"),
        tests("scenes", "mrroc-hil", only or "random_scenes", MRROC_RANDOM_SEED=str(seed), MRROC_RANDOM_TIMES="100"),
        tests("limits", "mrroc-controller", only or "when_a_limit_rises", MRROC_RANDOM_TIMES="25"),
        Part("tries", "test", tries, needs=["build"], processors=2),
        Part("features", "test", *features, lock="target", processors=2),
        Part("fuzz", "test", Command("tests/fuzz", FUZZ_SECONDS, limit=14_400), processors=2),
        Part("mutants", "test", Command("tests/mutants", limit=14_400), processors=2),
    ]


def rows():
    """Rows of the page by the name of their part."""
    if not PAGE.exists():
        return {}
    matches = (ROW.match(line) for line in PAGE.read_text().splitlines())
    return {match[1]: match for match in matches if match}


def write(done, seed):
    """Replaces the rows of the parts that ran."""
    commit = git("rev-parse", "--short=10", "HEAD") or "unknown"
    if git("status", "--porcelain", "--untracked-files=no"):
        commit += " and changes"
    today = datetime.date.today().isoformat()
    text = PAGE.read_text()
    for part in done:
        if part.name == "build" or part.outcome is None:
            continue
        tests = sum(result.passed() for result in part.results() if hasattr(result, "passed"))
        said = f"{part.outcome}, {tests} tests" if tests else part.outcome
        row = f"| `{part.name}` | {said} | {part.wall:.0f} s | {seed} | {today} | {commit} |"
        text = re.sub(rf"^\| `{part.name}` \|.*$", row, text, flags=re.MULTILINE)
    PAGE.write_text(text)


def warning():
    """What to say if the page is older than the code that it judges."""
    old = []
    for name, row in rows().items():
        commit = row[6].split()[0]
        if commit == "-":
            old.append(f"{name} was never run")
            continue
        changes = git("rev-list", "--count", f"{commit}..HEAD", "--", *JUDGED)
        if changes is None:
            old.append(f"{name} judges the commit {commit}, which this clone does not have")
        elif changes != "0":
            old.append(f"{name} is {changes} commits of the code behind")
    return f"warning: {PAGE.relative_to(ROOT)}: {'; '.join(old)}; run tests/run long" if old else None
