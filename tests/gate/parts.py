"""The parts of each ring.

A ring is a list of parts. `quick` needs no root, no network and no clock. `run` is the test command of the README.
"""
import json
import os
import subprocess
import sys

from . import long
from .command import ROOT, Command
from .executables import Executables, Messages
from .schedule import Part

LOCKED = "--locked"
ALL = None


def root(*words):
    """A command that needs root."""
    return words if os.geteuid() == 0 else ("sudo", *words)


def left_out(option):
    """Why the parts of `option` are left out, or nothing."""
    named = os.environ.get("MRROC_LEAVE_OUT", "").split(",")
    return f"MRROC_LEAVE_OUT has {option}" if option in named else None


def gate_part():
    """Tests of the gate itself."""
    return Part("gate", "test", Command(sys.executable, "-B", "-m", "unittest", "-q", "gate.test_gate",
                                        env={"PYTHONPATH": str(ROOT / "tests")}), processors=0.6)


def format_part():
    outside = ["tests/peers/rust/Cargo.toml", "tests/outside/Cargo.toml", "tests/sanitized/Cargo.toml",
               "examples/five-bar/Cargo.toml", "examples/own-sensor/Cargo.toml"]
    return Part(
        "format", "build", Command("cargo", "fmt", "--all", "--check"),
        *[Command("cargo", "fmt", "--manifest-path", manifest, "--check") for manifest in outside],
    )


def circles_part():
    """Circles of modules, and files that name a kind of device."""
    return Part("circles", "test", Command("tests/circles"), processors=0.6)


# One selection of packages for all builds: another selection may give a crate other features, and build it again.
WHOLE = ["--workspace", LOCKED]
HOOKS = ["--features", "mrroc-tests/test-hooks"]
MESSAGES = ["--no-run", "--message-format", "json-render-diagnostics"]
# For an executable that is run once.
UNOPTIMISED = ["--config", "profile.release.package.mrroc.opt-level=0"]


def unit_targets():
    """Names of the targets of tests of single crates."""
    words = ["cargo", "metadata", "--no-deps", "--offline", "--format-version", "1"]
    metadata = json.loads(subprocess.run(words, cwd=ROOT, check=True, capture_output=True).stdout)
    names = {target["name"] for package in metadata["packages"] for target in package["targets"]
             if target["kind"] == ["test"]}
    return ["--lib", "--bins"] + [word for name in sorted(names - {"system", "clock", "hooks"}) for word in ("--test", name)]


def release_part(messages):
    """Programs and system tests. The programs are those that the README's commands build."""
    programs = ["cargo", "build", "--release", *WHOLE, "--quiet", "--bins", "--examples"]
    tests = ["cargo", "test", "--release", *WHOLE, "--test", "system", "--test", "clock", *MESSAGES]
    return Part("release", "build", Command(*programs), Command(*tests, reader=messages), processors=ALL, lock="target")


def unit_parts(only, *builds):
    """Tests of single crates, and tests with hooks of the library."""
    messages = Messages()
    run = Executables(messages, only=only, chosen=lambda name: True, threads=os.cpu_count(), at_once=2)
    builds = [Command(*build, *MESSAGES, reader=messages) for build in builds]
    return [
        Part("build", "build", *builds, processors=ALL, lock="target"),
        Part("units", "test", run, needs=["build"], processors=ALL),
    ]


def system_part(messages, only):
    """System tests in virtual time. They keep all processors busy."""
    run = Executables(messages, only=only, chosen="mrroc-tests/system".__eq__, threads=os.cpu_count() + 1)
    return Part("system", "test", run, needs=["release"], processors=ALL)


def quick(only):
    build = ["cargo", "test", *WHOLE, *HOOKS, *unit_targets(), "--test", "hooks"]
    return [gate_part(), format_part(), circles_part(), *unit_parts(only, build)]


def run(only):
    messages = Messages()
    vcan, qemu, peers, package = map(left_out, ["vcan", "qemu", "peers", "package"])
    units = ["cargo", "test", "--release", *WHOLE, *unit_targets()]
    with_hooks = ["cargo", "test", "--release", *WHOLE, *HOOKS, *UNOPTIMISED, "--test", "hooks"]
    documented = ["cargo", "test", "--release", *WHOLE, "--quiet", "--doc"]
    lints = ["cargo", "clippy", LOCKED, "--quiet", "--workspace", *HOOKS, "--all-targets", "--", "-D", "warnings"]
    documentation = ["cargo", "doc", *WHOLE, *HOOKS, "--no-deps", "--quiet"]
    # Most of these tests wait for a clock. Their programs precede all others, which only root may arrange.
    clock = Executables(messages, only=only, chosen="mrroc-tests/clock".__eq__, threads=8 * os.cpu_count(),
                        niceness=-10)
    return [
        Part("packages", "download", Command("tests/install", "packages")),
        Part("kernel", "download", Command("tests/install", "kernel"), needs=["packages"], left_out=qemu),
        Part("python", "download", Command("tests/install", "python"), needs=["packages"], left_out=peers),
        Part("debian", "download", Command(*root("packaging/test", "prepare")), needs=["packages"], left_out=package),
        gate_part(),
        format_part(),
        circles_part(),
        Part("dependencies", "build", Command("tests/deny"), needs=["packages"]),
        release_part(messages),
        Part("peers", "build", Command("tests/install", "peers"), needs=["packages"], processors=ALL, left_out=peers),
        Part("clock", "test", clock, needs=["release", "packages", "kernel", "python", "peers"], processors=0.6),
        Part("readme", "test", Command(sys.executable, "tests/readme"), needs=["release"], after=["clock"],
             processors=0.6),
        system_part(messages, only),
        *unit_parts(only, units, with_hooks),
        Part("outside-build", "build", Command("tests/outside/run", "build"), needs=["release"], processors=ALL,
             lock="target"),
        Part("outside", "test", Command("tests/outside/run"), needs=["outside-build"], after=["clock"], processors=0.6),
        Part("faults", "test", Command("tests/fault-table"), needs=["release"]),
        Part("documented", "test", Command(*documented), needs=["release"], processors=ALL, lock="target"),
        Part("lints", "build", Command(*lints), processors=ALL, lock="target"),
        Part("documentation", "build", Command(*documentation, env={"RUSTDOCFLAGS": "-D warnings"}), processors=ALL,
             lock="target"),
        Part("sanitizer-build", "build", Command("tests/realtime-sanitizer", "build"), processors=ALL),
        Part("sanitizer", "test", Command("tests/realtime-sanitizer"), needs=["sanitizer-build"], after=["clock"],
             processors=0.6),
        Part("package", "test", Command("packaging/build", "release"), Command(*root("packaging/test")),
             needs=["debian", "release"], lock="target", left_out=package),
    ]


RINGS = ["quick", "run", "long"]


def of(ring, only, seed):
    """The parts of a ring."""
    return long.parts(only, seed) if ring == "long" else {"quick": quick, "run": run}[ring](only)
