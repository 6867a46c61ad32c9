"""Common parts of the scripts: opening a bus, and a record of its last frames."""

import collections
import struct
import time

import can
import canopen


def add_arguments(parser):
    parser.add_argument("--interface", required=True, help="python-can's: slcan, socketcan")
    parser.add_argument("--channel", required=True, help="a tty or a network interface")
    parser.add_argument("--eds", required=True, help="electronic data sheet of the node")
    parser.add_argument("--node", type=int, default=1, help="node-ID, 1 to 127")


def open_bus(arguments):
    options = {"interface": arguments.interface, "channel": arguments.channel}
    if arguments.interface == "slcan":
        # The device at the other end has no bootloader, so no wait is necessary.
        options.update(bitrate=1_000_000, sleep_after_open=0)
    return can.Bus(**options)


class Wire:
    """A network with a record of its last frames in the notation of candump."""

    def __init__(self, arguments):
        self.last = collections.deque(maxlen=24)
        self.began = time.monotonic()
        bus = open_bus(arguments)
        self._send = bus.send
        bus.send = self._sent
        self.network = canopen.Network(bus)
        self.network.listeners.append(self._received)
        self.network.connect()

    def _note(self, arrow, message):
        at = time.monotonic() - self.began
        frame = f"{message.arbitration_id:03X}#{message.data.hex().upper()}"
        self.last.append(f"{at:9.4f} {arrow} {frame}")

    def _sent(self, message, timeout=None):
        self._note("->", message)
        self._send(message, timeout)

    def _received(self, message):
        self._note("<-", message)

    def send(self, identifier, text):
        """Sends a data frame, given in hexadecimal."""
        self.network.send_message(identifier, bytes.fromhex(text))

    def ask(self, node, text, timeout=1.0):
        """Sends an SDO request, given in hexadecimal. Returns the answer in hexadecimal, or None."""
        answers = []
        listen = lambda _, data, __: answers.append(data.hex().upper())
        self.network.subscribe(0x580 + node, listen)
        try:
            self.send(0x600 + node, text)
            until(lambda: answers, timeout)
        finally:
            self.network.unsubscribe(0x580 + node, listen)
        return answers[0] if answers else None


def until(condition, timeout):
    """Whether the condition becomes true within the time limit, s."""
    end = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.002)
    return True


def word(value, size):
    """Bytes of a number for an object of this length."""
    return struct.pack("<q", value)[:size]
