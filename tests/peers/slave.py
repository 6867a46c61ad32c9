"""A drive on python-canopen's LocalNode, which provides the SDO server, heartbeats and PDO maps.

This script adds NMT resets, SYNC, the power states of CiA 402, and modes of operation that reach every set-point at
once. The drive boots, and serves until its standard input is closed.
"""

import argparse
import sys
import threading

import canopen

from power import CSP, DISABLED, ENABLED, HOMING, next_power, status
from wire import Wire, add_arguments

PRE_OPERATIONAL, OPERATIONAL = 127, 5
RPDOS, TPDOS = range(1, 5), range(1, 5)


def dictionary(eds, node):
    """Object dictionary of the drive, and an object of any length, 0x2F00."""
    objects = canopen.import_od(eds, node)
    domain = canopen.objectdictionary.ODVariable("domain", 0x2F00)
    domain.data_type = canopen.objectdictionary.DOMAIN
    domain.access_type = "rw"
    objects.add_object(domain)
    return objects


class Drive:
    def __init__(self, network, node, eds):
        self.node = canopen.LocalNode(node, dictionary(eds, node))
        self.lock = threading.Lock()
        self.word = 0
        self.power = DISABLED
        self.network = network
        network.add_node(self.node)
        self.node.add_write_callback(self.written)
        network.subscribe(0, self.commanded)
        network.subscribe(0x80, self.synchronised)
        self.boot()

    def boot(self):
        self.power, self.word = DISABLED, 0
        # Objects without a value in the data sheet are measurements, and zero here.
        for entry in self.node.object_dictionary.values():
            single = isinstance(entry, canopen.objectdictionary.ODVariable)
            for variable in [entry] if single else entry.values():
                if variable.fixed_size and variable.default is None:
                    values = self.node.data_store.setdefault(variable.index, {})
                    values.setdefault(variable.subindex, variable.encode_raw(0))
        self.set(0x6064, 1000)
        # Unit µN·m; value from the cell.
        self.set(0x6076, 420_000)
        self.set(0x6061, self.get(0x6060))
        self.show()
        # The boot-up frame is sent last, because the host may react to it before the next line runs.
        self.node.nmt.state = "PRE-OPERATIONAL"
        self.network.send_message(0x700 + self.node.id, [0])

    def get(self, index):
        variable = self.node.object_dictionary[index]
        return variable.decode_raw(self.node.get_data(index, 0))

    def set(self, index, value):
        variable = self.node.object_dictionary[index]
        self.node.data_store.setdefault(index, {})[0] = variable.encode_raw(value)

    def commanded(self, _, data, __):
        """Performs an NMT command that LocalNode has received; LocalNode itself only changes its state."""
        command, node = data
        if node not in (0, self.node.id):
            return
        with self.lock:
            if command in (0x81, 0x82):
                self.node.nmt.stop_heartbeat()
                kept = {} if command == 0x81 else {k: v for k, v in self.node.data_store.items() if k >= 0x2000}
                self.node.data_store.clear()
                self.node.data_store.update(kept)
                self.boot()
            elif command == 0x01:
                for pdo in (self.node.tpdo, self.node.rpdo):
                    for number in RPDOS:
                        pdo[number].read()
                for number in RPDOS:
                    if self.node.rpdo[number].enabled:
                        self.network.subscribe(self.node.rpdo[number].cob_id, self.received)

    def received(self, identifier, data, _):
        """Processes an RPDO. A synchronous RPDO waits for SYNC."""
        for number in RPDOS:
            pdo = self.node.rpdo[number]
            if pdo.enabled and pdo.cob_id == identifier and pdo.trans_type > 240:
                with self.lock:
                    self.take(pdo, data)

    def take(self, pdo, data):
        pdo.data = bytearray(data)
        for variable in pdo:
            # Written as by SDO, so that `written` is called.
            self.node.set_data(variable.index, variable.subindex, bytes(variable.data))

    def synchronised(self, *_):
        with self.lock:
            if self.node.nmt.state != "OPERATIONAL":
                return
            for number in RPDOS:
                pdo = self.node.rpdo[number]
                if pdo.enabled and pdo.trans_type <= 240 and pdo.is_received:
                    pdo.is_received = False
                    self.take(pdo, pdo.data)
            if self.power == ENABLED and self.get(0x6061) == CSP:
                self.set(0x6064, self.get(0x607A))
            self.show()
            for number in TPDOS:
                pdo = self.node.tpdo[number]
                if pdo.enabled and pdo.trans_type <= 240:
                    for variable in pdo:
                        variable.set_data(self.node.get_data(variable.index, variable.subindex))
                    pdo.transmit()

    def written(self, index, data, **_):
        value = int.from_bytes(data, "little", signed=True)
        if index == 0x6040:
            word = value & 0xFFFF
            self.power = next_power(self.power, word, self.word)
            if self.get(0x6061) == HOMING and self.power == ENABLED and word & 0x10 and not self.word & 0x10:
                self.set(0x6064, 0)
            self.word = word
        elif index == 0x6060:
            self.set(0x6061, value)
        self.show()

    def show(self):
        operational = self.node.nmt.state == "OPERATIONAL"
        self.set(0x6041, status(self.power, self.get(0x6061), self.word, operational))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    arguments = parser.parse_args()
    wire = Wire(arguments)
    Drive(wire.network, arguments.node, arguments.eds)
    sys.stdin.read()
    wire.network.disconnect()


main()
