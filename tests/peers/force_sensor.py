"""A serial force/torque sensor on a pseudo-terminal, with the protocol of the IRp-6 laboratory, independent of mrroc.

`q` is answered by six 16-bit counts, high byte first, and two bytes. `b` makes the present load zero. The first line
of the output is the path of the pseudo-terminal. The sensor ends when its standard input is closed. Before that, the
standard input takes one command per line, and the output confirms each command with `done`:

  load FX FY FZ TX TY TZ    sets the wrench, N and N·m
  silent | speak            from now on, queries are lost, and there is no text | are answered again
  cut N                     sends only the first N bytes of the next reply
  garbage HEX               sends these bytes before the next reply
  restart                   power cycle: no bias, and the text again
  counts                    prints the numbers of replies, of lost queries and of biases, before `done`

A pseudo-terminal has no bit rate. A reply arrives in one piece at the time at which its last byte would arrive.
"""

import argparse
import os
import random
import select
import struct
import sys
import termios
import time
import tty

# Time of a byte on the line, s: 115200 baud, 10 bits.
BYTE = 10 / 115200
# Size of a count, N and N·m.
SCALE = [10 / 115] * 3 + [5 / 940] * 3
TEXT = b"force/torque sensor in Python\r\n"


def limited(value, limit):
    return max(-limit, min(limit, value))


class Sensor:
    """Reading and replies, as a function of bytes and time."""

    def __init__(self, arguments):
        self.arguments = arguments
        self.random = random.Random(arguments.seed)
        self.load = list(arguments.load)
        self.speaks = not arguments.silent
        self.cut = None
        self.garbage = b""
        self.replies = self.lost = self.biases = 0
        # The reply on its way, and the time at which it has arrived.
        self.reply = None
        self.restart()

    def restart(self):
        self.bias = [0.0] * 6
        self.reply = (time.monotonic() + len(TEXT) * BYTE, TEXT) if self.speaks else None

    def sample(self):
        """Reading without bias, N and N·m."""
        noise = [self.arguments.force_noise] * 3 + [self.arguments.torque_noise] * 3
        limits = [self.arguments.force_range] * 3 + [self.arguments.torque_range] * 3
        noisy = (load + self.random.gauss(0, sigma) for load, sigma in zip(self.load, noise))
        return [limited(value, limit) for value, limit in zip(noisy, limits)]

    def take(self, byte, now):
        if byte == ord("b"):
            self.bias = self.sample()
            self.biases += 1
        elif byte == ord("q") and (self.reply or not self.speaks):
            self.lost += 1
        elif byte == ord("q"):
            values = [value - bias for value, bias in zip(self.sample(), self.bias)]
            counts = [round(limited(value / scale, 32767)) for value, scale in zip(values, SCALE)]
            data = self.garbage + struct.pack(">6h2s", *counts, self.arguments.trailer)[: self.cut]
            self.cut, self.garbage = None, b""
            self.reply = (now + len(data) * BYTE, data)
            self.replies += 1

    def due(self, now):
        """Bytes that have arrived at the host by now."""
        if not self.reply or self.reply[0] > now:
            return b""
        data, self.reply = self.reply[1], None
        return data

    def command(self, line):
        word, *rest = line.split()
        if word == "load":
            self.load = [float(value) for value in rest]
            assert len(self.load) == 6, line
        elif word in ("silent", "speak"):
            self.speaks = word == "speak"
        elif word == "cut":
            self.cut = int(rest[0])
        elif word == "garbage":
            self.garbage = bytes.fromhex(rest[0])
        elif word == "restart":
            self.restart()
        elif word == "counts":
            print(self.replies, self.lost, self.biases)
        else:
            raise SystemExit(f"no command is called {word!r}")
        print("done", flush=True)


def serve(sensor, master):
    unread = b""
    while True:
        now = time.monotonic()
        if data := sensor.due(now):
            os.write(master, data)
        wait = max(0.0, sensor.reply[0] - time.monotonic()) if sensor.reply else None
        ready, _, _ = select.select([master, sys.stdin.fileno()], [], [], wait)
        if master in ready:
            for byte in os.read(master, 4096):
                sensor.take(byte, time.monotonic())
        if sys.stdin.fileno() in ready:
            read = os.read(sys.stdin.fileno(), 4096)
            if not read:
                return
            *lines, unread = (unread + read).split(b"\n")
            for line in lines:
                sensor.command(line.decode())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--load", type=float, nargs=6, default=[0.0] * 6, help="wrench, N and N·m")
    parser.add_argument("--force-noise", type=float, default=0.0, help="standard deviation, N")
    parser.add_argument("--torque-noise", type=float, default=0.0, help="standard deviation, N·m")
    parser.add_argument("--force-range", type=float, default=400.0, help="greatest force, N")
    parser.add_argument("--torque-range", type=float, default=10.0, help="greatest torque, N·m")
    parser.add_argument("--trailer", type=bytes.fromhex, default=b"\0\0", help="last two bytes of a reply")
    parser.add_argument("--silent", action="store_true", help="begins with the command silent")
    parser.add_argument("--seed", type=int, default=0, help="seed of the noise")
    arguments = parser.parse_args()
    master, slave = os.openpty()
    tty.setraw(slave, termios.TCSANOW)
    print(os.ttyname(slave), flush=True)
    # The open slave keeps the terminal alive without a host.
    serve(Sensor(arguments), master)


main()
