"""A client of a serial force/torque sensor, written from the protocol alone: greeting, mean, noise, saturation, bias,
lost query.

Each check is a claim, printed with `ok` or with `FAILED`, the reason and the last bytes. The exit status is 1 after a
failure. The expected reading comes as arguments. A channel with a load beyond its range is expected to be saturated.
"""

import argparse
import collections
import math
import os
import select
import struct
import sys
import termios
import time

from checks import check, run, same, true

# Longest time for an answer on a busy test machine, s.
PATIENCE = 10.0
# Time without bytes after which no reply follows, s. A reply takes 1.3 ms.
QUIET = 0.2
REPLY = 14
SAMPLES = 1000
NAMES = ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"]
# Size of a count, N and N·m.
SCALE = [10 / 115] * 3 + [5 / 940] * 3


def open_line(path):
    """A tty in raw mode with 115200 8N1. Bytes that wait are kept."""
    line = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    settings = termios.tcgetattr(line)
    settings[0] = settings[1] = settings[3] = 0
    settings[2] = termios.CS8 | termios.CREAD | termios.CLOCAL
    settings[4] = settings[5] = termios.B115200
    termios.tcsetattr(line, termios.TCSANOW, settings)
    return line


class Client:
    def __init__(self, arguments):
        self.line = open_line(arguments.tty)
        self.last = collections.deque(maxlen=24)
        self.unread = b""
        self.trailer = arguments.trailer
        self.limits = [arguments.force_range] * 3 + [arguments.torque_range] * 3
        self.noise = [arguments.force_noise] * 3 + [arguments.torque_noise] * 3
        self.load = arguments.load
        self.unbiased = None
        self.saturated = [abs(load) > limit for load, limit in zip(self.load, self.limits)]

    def write(self, data):
        self.last.append(f"-> {data.hex()}")
        os.write(self.line, data)

    def receive(self, patience):
        """Takes the bytes of the line. Returns whether there were any within the time limit, s."""
        if not select.select([self.line], [], [], patience)[0]:
            return False
        data = os.read(self.line, 4096)
        self.last.append(f"<- {data.hex()}")
        self.unread += data
        return True

    def take(self, count):
        """The next bytes, which must arrive within PATIENCE."""
        end = time.monotonic() + PATIENCE
        while len(self.unread) < count:
            left = end - time.monotonic()
            true(left > 0 and self.receive(left), f"{len(self.unread)} of {count} bytes")
        data, self.unread = self.unread[:count], self.unread[count:]
        return data

    def is_quiet(self):
        while self.receive(QUIET):
            pass
        same(self.unread, b"", "bytes without a query")

    def counts(self):
        self.write(b"q")
        return self.counts_of_reply()

    def counts_of_reply(self):
        *counts, trailer = struct.unpack(">6h2s", self.take(REPLY))
        same(trailer, self.trailer, "last two bytes")
        return counts

    def series(self):
        """SAMPLES readings of each channel, N and N·m."""
        readings = [self.counts() for _ in range(SAMPLES)]
        return [[counts[at] * SCALE[at] for counts in readings] for at in range(6)]

    def series_without_bias(self):
        """The series that the checks before the bias share."""
        self.unbiased = self.unbiased or self.series()
        return self.unbiased

    def deviation(self, at):
        """Standard deviation of a reading with the error of its rounding."""
        return math.hypot(self.noise[at], SCALE[at] / math.sqrt(12))

    def free(self):
        return [at for at in range(6) if not self.saturated[at]]


def mean(values):
    return sum(values) / len(values)


def covariance(a, b):
    middle = mean(a), mean(b)
    return mean([(x - middle[0]) * (y - middle[1]) for x, y in zip(a, b)])


@check
def one_line_of_text_follows_power_on(c):
    text = b""
    while not text.endswith(b"\n"):
        text += c.take(1)
        true(len(text) <= 80, f"no end of line in {text}")
    true(text.strip() and text.strip().decode("ascii").isprintable(), f"no text: {text}")
    c.is_quiet()


@check
def every_query_has_one_reply(c):
    for _ in range(20):
        c.counts()
    c.is_quiet()


@check
def the_mean_is_the_load(c):
    for at, values in enumerate(c.series_without_bias()):
        if c.saturated[at]:
            continue
        # Without noise, the error of the rounding is the same in all samples.
        error = 5 * c.noise[at] / math.sqrt(SAMPLES) + (SCALE[at] / 2 if c.noise[at] < SCALE[at] / 2 else 0)
        found = f"{NAMES[at]}: {mean(values)}, expected {c.load[at]} ± {error}"
        true(abs(mean(values) - c.load[at]) <= error + 1e-9, found)


@check
def the_noise_is_white_and_has_its_deviation(c):
    series = c.series_without_bias()
    five_errors = 5 / math.sqrt(SAMPLES)
    for at in c.free():
        if c.noise[at] == 0:
            same(len(set(series[at])), 1, f"number of values of {NAMES[at]} without noise")
            continue
        found = math.sqrt(covariance(series[at], series[at]))
        true(abs(found / c.deviation(at) - 1) < five_errors, f"{NAMES[at]}: {found}, expected {c.deviation(at)}")
        successive = covariance(series[at][:-1], series[at][1:]) / found**2
        true(abs(successive) < five_errors, f"{NAMES[at]}: correlation {successive} of successive samples")
        for other in c.free():
            if other > at and c.noise[other] > 0:
                deviation = math.sqrt(covariance(series[other], series[other]))
                together = covariance(series[at], series[other]) / found / deviation
                true(abs(together) < five_errors, f"correlation {together} of {NAMES[at]} and {NAMES[other]}")


@check
def a_saturated_channel_stays_at_its_range(c):
    for values in [c.counts() for _ in range(50)]:
        for at in range(6):
            limit = round(c.limits[at] / SCALE[at])
            if c.saturated[at]:
                same(values[at], int(math.copysign(limit, c.load[at])), NAMES[at])
            else:
                true(abs(values[at]) < limit, f"{NAMES[at]} is at its range")


@check
def other_bytes_have_no_reply(c):
    c.write(bytes(byte for byte in range(256) if byte not in b"bq"))
    c.is_quiet()
    c.counts()


@check
def a_query_during_a_reply_is_lost(c):
    for _ in range(20):
        c.write(b"qq")
        c.counts_of_reply()
    c.counts()
    c.is_quiet()


@check
def the_bias_has_no_reply_and_makes_the_load_zero(c):
    before = c.counts()
    c.write(b"b")
    c.is_quiet()
    for at, values in enumerate(c.series()):
        # The bias is one sample with its noise.
        error = 5 * c.noise[at] * math.sqrt(1 + 1 / SAMPLES) + SCALE[at] / 2
        found = f"{NAMES[at]}: {mean(values)} after the bias, {before[at] * SCALE[at]} before"
        true(abs(mean(values)) <= error, found)
        if c.saturated[at] or c.noise[at] == 0:
            same(set(values), {0.0}, NAMES[at])


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tty", required=True, help="line of the sensor")
    parser.add_argument("--load", type=float, nargs=6, required=True, help="wrench on the sensor, N and N·m")
    parser.add_argument("--force-noise", type=float, default=0.0, help="standard deviation, N")
    parser.add_argument("--torque-noise", type=float, default=0.0, help="standard deviation, N·m")
    parser.add_argument("--force-range", type=float, default=400.0, help="greatest force, N")
    parser.add_argument("--torque-range", type=float, default=10.0, help="greatest torque, N·m")
    parser.add_argument("--trailer", type=bytes.fromhex, default=b"\0\0", help="last two bytes of a reply")
    arguments = parser.parse_args()
    client = Client(arguments)
    return 1 if run(client, client) else 0


sys.exit(main())
