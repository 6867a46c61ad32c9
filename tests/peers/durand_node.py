"""A CiA 402 drive on durand 0.5.0's node, which provides the SDO server, PDOs, NMT, heartbeats, EMCY and LSS.

The drive boots, and serves until its standard input is closed. Behaviour of durand: objects that a reset does not restore keep
their values. A TPDO of every nth SYNC is sent at every SYNC after the first n. A node without a node-ID boots on 0x7FF.
"""

import argparse
import asyncio
import sys

import can
from durand import CANBusNetwork, MinimalNode, Variable, Record, Array
from durand.datatypes import DatatypeEnum as Type
from durand.services.nmt import StateEnum

from power import CSP, DISABLED, ENABLED, HOMING, next_power, status

IDENTITY = {1: 0x0000_0D0D, 2: 0x0050_0000, 3: 0x0000_0005}
# A value written here is sent as an emergency; 0 clears the error.
EMERGENCY = 0x2F01
DEVICE_TYPE = 0x0002_0192

VARIABLES = [
    (0x2000, Type.UNSIGNED32, "rw", 0),
    (0x2001, Type.INTEGER16, "rw", 0),
    (0x2002, Type.UNSIGNED8, "rw", 0),
    (0x2F00, Type.DOMAIN, "rw", b""),
    (EMERGENCY, Type.UNSIGNED16, "rw", 0),
    (0x603F, Type.UNSIGNED16, "ro", 0),
    (0x6040, Type.UNSIGNED16, "rw", 0),
    (0x6041, Type.UNSIGNED16, "ro", 0),
    (0x6007, Type.INTEGER16, "rw", 0),
    (0x605A, Type.INTEGER16, "rw", 0),
    (0x6060, Type.INTEGER8, "rw", 0),
    (0x6061, Type.INTEGER8, "ro", 0),
    (0x6064, Type.INTEGER32, "ro", 1000),
    (0x6065, Type.UNSIGNED32, "rw", 0),
    (0x6077, Type.INTEGER16, "ro", 0),
    (0x607A, Type.INTEGER32, "rw", 0),
    (0x6085, Type.UNSIGNED32, "rw", 0),
    (0x6098, Type.INTEGER8, "rw", 0),
    (0x609A, Type.UNSIGNED32, "rw", 0),
    # Homing and cyclic synchronous position mode.
    (0x6502, Type.UNSIGNED32, "ro", 0x0000_00A0),
]
RECORDS = {
    0x6099: {1: (Type.UNSIGNED32, 0), 2: (Type.UNSIGNED32, 0)},
    0x60C2: {1: (Type.UNSIGNED8, 1), 2: (Type.INTEGER8, -3)},
}


class Drive:
    def __init__(self, network, node_id, serial):
        self.node = MinimalNode(network, node_id)
        self.objects = self.node.object_dictionary
        for index, kind, access, value in VARIABLES:
            self.objects[index] = Variable(kind, access, value)
        for index, subs in RECORDS.items():
            self.objects[index] = Record()
            for sub, (kind, value) in subs.items():
                self.objects[index][sub] = Variable(kind, "rw", value)
        self.objects[0x1016] = Array(Variable(Type.UNSIGNED32, "rw"), length=2)
        for sub, value in {**IDENTITY, 4: serial}.items():
            self.objects.write(0x1018, sub, value)
        self.objects.write(0x1000, 0, DEVICE_TYPE)
        self.objects.write(0x1008, 0, b"durand")
        self.power, self.word = DISABLED, 0
        # Runs before the TPDOs sample.
        self.node.sync.callbacks.add(self.synchronised)
        self.node.nmt.state_callbacks.add(self.entered)
        for index in (0x6040, 0x6060):
            self.objects.download_callbacks[(index, 0)].add(lambda _: self.show())
        self.objects.download_callbacks[(EMERGENCY, 0)].add(self.fail)
        self.show()

    def get(self, index):
        return self.objects.read(index, 0)

    def entered(self, state):
        if state == StateEnum.INITIALISATION:
            self.power, self.word = DISABLED, 0
            self.objects.write(0x6040, 0, 0)
        self.show()

    def synchronised(self):
        if self.power == ENABLED and self.get(0x6061) == CSP:
            self.objects.write(0x6064, 0, self.get(0x607A))

    def fail(self, code):
        self.node.emcy.set(code, 0x21 if code else 0, bytes([1, 2, 3, 4, 5]) if code else b"")

    def show(self):
        word, mode = self.get(0x6040), self.get(0x6060)
        self.power = next_power(self.power, word, self.word)
        if mode == HOMING and self.power == ENABLED and word & 0x10 and not self.word & 0x10:
            self.objects.write(0x6064, 0, 0)
        self.word = word
        self.objects.write(0x6061, 0, mode)
        operational = self.node.nmt.state == StateEnum.OPERATIONAL
        self.objects.write(0x6041, 0, status(self.power, mode, word, operational))


async def serve(interface, node, serial):
    loop = asyncio.get_running_loop()
    with can.Bus(interface="socketcan", channel=interface) as bus:
        network = CANBusNetwork(bus, loop=loop)
        Drive(network, node, serial)
        ended = asyncio.Event()
        loop.add_reader(sys.stdin, ended.set)
        await ended.wait()
        network.stop()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("interface")
    parser.add_argument("node", type=int, help="node-ID, 255 for none")
    parser.add_argument("serial", type=int)
    arguments = parser.parse_args()
    asyncio.run(serve(arguments.interface, arguments.node, arguments.serial))


main()
