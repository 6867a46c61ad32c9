"""The command line of the gate."""
import argparse
import os

from . import account, long, parts
from .command import ROOT
from .schedule import Schedule


def arguments(words):
    parser = argparse.ArgumentParser(prog="tests/run", description="Runs the tests of the project.")
    parser.add_argument("ring", nargs="?", choices=parts.RINGS, default="run",
                        help="quick: virtual time only, no root, no network; run: the default; long: hours")
    parser.add_argument("part", nargs="*", help="run these parts alone, with the parts that they need")
    parser.add_argument("--only", default="", metavar="TEXT", help="run only tests with TEXT in their name")
    parser.add_argument("--seed", type=int, default=1, help="seed of the long ring (default 1)")
    parser.add_argument("--list", action="store_true", help="list the parts")
    # A part may stand alone, without a ring.
    if words and words[0] not in parts.RINGS and not words[0].startswith("-"):
        words = ["run", *words]
    return parser.parse_args(words)


def chosen(every, names):
    """The parts called `names` and all parts that they need."""
    if not names:
        return every
    by_name = {part.name: part for part in every}
    unknown = [name for name in names if name not in by_name]
    if unknown:
        raise SystemExit(f"tests/run: no part {', '.join(unknown)}; the parts are {', '.join(by_name)}")
    wanted, rest = set(), list(names)
    while rest:
        name = rest.pop()
        if name not in wanted:
            wanted.add(name)
            rest += by_name[name].needs
    return [part for part in every if part.name in wanted]


def main(words):
    options = arguments(words)
    every = chosen(parts.of(options.ring, options.only, options.seed), options.part)
    if options.list:
        for part in every:
            needs = f" (needs {', '.join(part.needs)})" if part.needs else ""
            print(f"{part.name}{needs}")
        return 0
    (ROOT / "target/gate").mkdir(parents=True, exist_ok=True)
    host = Schedule(every).run()
    results = [result for part in every for result in part.results() if hasattr(result, "durations")]
    durations = [item for result in results for item in result.durations()]
    print("\n".join(account.table(every, durations, host)))
    for line in sorted({line for result in results for line in result.left_out()}):
        print(line)
    if options.ring == "long":
        long.write(every, options.seed)
    elif options.ring == "run" and (warning := long.warning()):
        print(warning)
    if os.environ.get("MRROC_LEAVE_OUT"):
        print(f"left out on request: {os.environ['MRROC_LEAVE_OUT']}")
    failed = [part.name for part in every if part.outcome == "FAILED" or part.outcome.startswith("not run")]
    if failed:
        print(f"failed: {', '.join(failed)}; the outputs are in target/gate")
    print(f"{sum(result.passed() for result in results)} passed, {sum(result.failed() for result in results)} failed")
    return 1 if failed else 0
