"""Tests of the gate itself: a part that fails, hangs, is left out or runs nothing is never green."""
import io
import unittest

from gate.command import ROOT, Command, Failed
from gate.libtest import Results, excerpt
from gate.schedule import Part, Schedule


def run(command):
    log = io.StringIO()
    command.run(log)
    return log.getvalue()


def outcomes(*parts):
    (ROOT / "target/gate").mkdir(parents=True, exist_ok=True)
    schedule = Schedule(list(parts))
    schedule.say = lambda text: None
    schedule.run()
    return [part.outcome for part in parts]


class Commands(unittest.TestCase):
    def test_output_and_processor_time_are_kept(self):
        command = Command("sh", "-c", "echo said; i=0; while [ $i -lt 200000 ]; do i=$((i+1)); done")
        self.assertIn("said", run(command))
        self.assertGreater(command.seconds, 0.01)

    def test_a_failure_shows_the_end_of_the_output(self):
        with self.assertRaisesRegex(Failed, "(?s)exit status 3.*the reason"):
            run(Command("sh", "-c", "echo the reason >&2; exit 3"))

    def test_a_hang_is_reported_with_its_threads_and_its_last_output(self):
        with self.assertRaisesRegex(Failed, "(?s)no end within 1 s.*sleep.*last output:.*begun"):
            run(Command("sh", "-c", "echo begun; sleep 1000", limit=1))

    def test_a_silent_command_without_work_hangs(self):
        with self.assertRaisesRegex(Failed, "no output and no work for 2 s"):
            run(Command("sleep", "1000", silence=2))

    def test_a_process_that_stays_behind_does_not_hold_the_part_up(self):
        run(Command("sh", "-c", "sleep 30 & echo done", limit=20))


class Parts(unittest.TestCase):
    def test_what_needs_a_failed_part_does_not_run(self):
        failing = Part("first", "build", Command("false"))
        self.assertEqual(outcomes(failing, Part("second", "test", Command("true"), needs=["first"])),
                         ["FAILED", "not run: a part that it needs did not pass"])

    def test_what_follows_a_failed_part_runs_after_it(self):
        failing = Part("first", "test", Command("sh", "-c", "sleep 0.3; false"), processors=0.1)
        follower = Part("second", "test", Command("true"), processors=0.1, after=["first", "absent"])
        self.assertEqual(outcomes(failing, follower), ["FAILED", "passed"])

    def test_a_part_that_is_left_out_says_why(self):
        said = Part("said", "test", Command("echo", "left out: sanitizer: no nightly"))
        asked = Part("asked", "test", Command("true"), left_out="MRROC_LEAVE_OUT has qemu")
        self.assertEqual(outcomes(said, asked),
                         ["left out: sanitizer: no nightly", "left out: MRROC_LEAVE_OUT has qemu"])

    def test_parts_with_one_lock_run_one_after_the_other(self):
        command = 'test ! -e "$0" && touch "$0" && sleep 0.3 && rm "$0"'
        place = str(ROOT / "target/gate/locked")
        parts = [Part(name, "build", Command("sh", "-c", command, place), processors=0.1, lock="it") for name in "ab"]
        self.assertEqual(outcomes(*parts), ["passed", "passed"])


class Tests(unittest.TestCase):
    def results(self, *lines):
        results = Results("crate")
        for line in lines:
            results.line(line)
        return results

    def test_results_and_durations_are_read_between_other_output(self):
        results = self.results(
            '{ "type": "suite", "event": "started", "test_count": 2 }',
            '{ "type": "test", "event": "started", "name": "one" }',
            'said before{ "type": "test", "name": "one", "event": "ok", "exec_time": 4.0, "stdout": '
            '"waited 1.500 s for processors\\nwaited 1.000 s for processors\\nleft out: vcan (one)\\n" }',
            '{ "type": "test", "name": "two", "event": "failed", "exec_time": 0.5, "stdout": "why" }',
            '{ "type": "suite", "event": "failed", "passed": 1, "failed": 1 }',
        )
        self.assertEqual(results.durations, [(1.5, "crate::one"), (0.5, "crate::two")])
        self.assertEqual((results.passed, results.left_out), (1, ["left out: vcan (one)"]))
        with self.assertRaisesRegex(Failed, "(?s)crate::two.*why"):
            results.end(101)

    def test_an_executable_that_dies_names_the_tests_that_ran(self):
        results = self.results('{ "type": "test", "event": "started", "name": "abort" }')
        with self.assertRaisesRegex(Failed, "(?s)exit status -6.*crate::abort"):
            results.end(-6)

    def test_an_executable_without_a_result_is_red(self):
        with self.assertRaisesRegex(Failed, "ran no tests"):
            self.results("nothing").end(0)

    def test_a_long_output_is_cut_at_its_begin(self):
        self.assertEqual(excerpt("a\nb\nc", most=2), "    … 1 lines before\n    b\n    c")


if __name__ == "__main__":
    unittest.main()
