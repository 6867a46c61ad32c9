"""A module of digital inputs and outputs (CiA 401) on python-canopen's LocalNode, with its outputs wired to its inputs.

LocalNode provides the SDO server, heartbeats and PDO maps. This script adds NMT resets, RPDO 1 with outputs, TPDO 1 with
inputs after a change and by the event timer, the watch of the host's heartbeat, and the error state of the outputs.

The node boots, and obeys commands from its standard input, each confirmed by `done`:
  outputs   prints the bytes of the outputs at the terminals, in hexadecimal
  reset     restarts the node
  silent    sends no TPDO any more, until `speak`
  speak     sends TPDOs again
"""

import argparse
import sys
import threading
import time

import canopen

from wire import Wire, add_arguments

INPUT, OUTPUT, ERROR_MODE, ERROR_VALUE = 0x6000, 0x6200, 0x6206, 0x6207


class Module:
    def __init__(self, network, node, eds):
        self.node = canopen.LocalNode(node, canopen.import_od(eds, node))
        self.network = network
        self.lock = threading.RLock()
        self.silent = False
        network.add_node(self.node)
        network.subscribe(0, self.commanded)
        self.boot()
        threading.Thread(target=self.watch, daemon=True).start()

    def boot(self):
        self.node.nmt.stop_heartbeat()
        self.node.data_store.clear()
        self.host, self.heard, self.sent = None, 0.0, 0.0
        self.wire()
        self.told = self.inputs()
        # The boot-up frame is sent last, because the host may react to it before the next line runs.
        self.node.nmt.state = "PRE-OPERATIONAL"
        self.network.send_message(0x700 + self.node.id, [0])

    def byte(self, index, block):
        return self.node.get_data(index, block)[0]

    def inputs(self):
        return [self.byte(INPUT, block) for block in range(1, 9)]

    def wire(self):
        for block in range(1, 9):
            self.node.data_store.setdefault(INPUT, {})[block] = bytes([self.byte(OUTPUT, block)])

    def commanded(self, _, data, __):
        """Performs an NMT command that LocalNode has received; LocalNode itself only changes its state."""
        command, node = data
        if node not in (0, self.node.id):
            return
        with self.lock:
            if command in (0x81, 0x82):
                self.boot()
            elif command == 0x01:
                self.node.tpdo[1].read()
                self.node.rpdo[1].read()
                self.network.subscribe(self.node.rpdo[1].cob_id, self.received)
                self.tell()

    def received(self, _, data, __):
        with self.lock:
            if self.node.nmt.state != "OPERATIONAL" or not self.node.rpdo[1].enabled:
                return
            for variable, byte in zip(self.node.rpdo[1], data):
                self.node.set_data(variable.index, variable.subindex, bytes([byte]))
            self.wire()
            if self.inputs() != self.told:
                self.tell()

    def tell(self):
        """Sends TPDO 1."""
        self.told, self.sent = self.inputs(), time.monotonic()
        tpdo = self.node.tpdo[1]
        if tpdo.enabled and not self.silent:
            for variable in tpdo:
                variable.set_data(self.node.get_data(variable.index, variable.subindex))
            tpdo.transmit()

    def hear(self, *_):
        self.heard = time.monotonic()

    def watch(self):
        """Sends TPDO 1 by its event timer, and watches the heartbeat of the host."""
        while True:
            time.sleep(0.005)
            with self.lock:
                if self.node.nmt.state != "OPERATIONAL":
                    continue
                now = time.monotonic()
                timer = int.from_bytes(self.node.get_data(0x1800, 5), "little")
                if timer and now - self.sent >= timer * 1e-3:
                    self.tell()
                consumer = int.from_bytes(self.node.get_data(0x1016, 1), "little")
                host, limit = consumer >> 16 & 0x7F, (consumer & 0xFFFF) * 1e-3
                if limit and host != self.host:
                    self.host = host
                    self.hear()
                    self.network.subscribe(0x700 + host, self.hear)
                if limit and now - self.heard > limit and self.node.get_data(0x1029, 1)[0] == 2:
                    self.stop()

    def stop(self):
        """The error state after the loss of the host."""
        for block in range(1, 9):
            mode, value = self.byte(ERROR_MODE, block), self.byte(ERROR_VALUE, block)
            level = self.byte(OUTPUT, block) & ~mode | value & mode
            self.node.data_store.setdefault(OUTPUT, {})[block] = bytes([level])
        self.wire()
        self.node.nmt.state = "STOPPED"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_arguments(parser)
    arguments = parser.parse_args()
    wire = Wire(arguments)
    module = Module(wire.network, arguments.node, arguments.eds)
    for line in sys.stdin:
        with module.lock:
            match line.strip():
                case "outputs":
                    print(bytes(module.byte(OUTPUT, block) for block in range(1, 9)).hex())
                case "reset":
                    module.boot()
                case "silent":
                    module.silent = True
                case "speak":
                    module.silent = False
                case other:
                    sys.exit(f"no command: {other}")
        print("done", flush=True)
    wire.network.disconnect()


main()
