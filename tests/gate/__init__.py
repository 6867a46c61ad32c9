"""The gate: what `tests/run` runs, and how.

`parts` lists the parts of each ring. `schedule` runs them, several at a time where the processors allow it. `command` runs
one command with a time limit. `libtest` reads the results of test executables. `account` measures the host, and prints
the table at the end.
"""
