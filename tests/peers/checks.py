"""Checks of a script: claims about one node, in the order of their definitions."""

import sys
import time
import traceback

import canopen

CHECKS = []


def check(function):
    CHECKS.append(function)
    return function


class Failed(Exception):
    pass


def same(found, expected, what="value"):
    if found != expected:
        show = lambda it: f"{it:#x}" if isinstance(it, int) else repr(it)
        raise Failed(f"{what}: {show(found)}, expected {show(expected)}")


def true(condition, what):
    if not condition:
        raise Failed(what)


def aborts(code, call):
    try:
        call()
    except canopen.SdoAbortedError as abort:
        same(abort.code, code, "abort code")
    else:
        raise Failed(f"went through, expected abort {code:#010x}")


def run(subject, wire, only=None):
    """Runs all checks, or those whose name contains `only`, and prints each claim. Returns the number of failures."""
    failed = 0
    for function in CHECKS:
        if only and only not in function.__name__:
            continue
        begun = time.monotonic()
        try:
            function(subject)
        except Exception as error:
            failed += 1
            print(f"FAILED {function.__name__}: {error}")
            if not isinstance(error, Failed):
                traceback.print_exc(file=sys.stdout)
            print(*wire.last, sep="\n")
        else:
            print(f"ok     {function.__name__} {time.monotonic() - begun:.2f} s")
        sys.stdout.flush()
    print(f"{len(CHECKS)} checks, {failed} failed")
    return failed
