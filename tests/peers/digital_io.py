"""python-canopen as the master of an emulated module of inputs and outputs. Each output is wired to the input of its number.

Each check is a claim, printed with `ok` or with `FAILED`, the reason and the last frames. The exit status is 1 after a failure.
"""

import argparse
import sys

import canopen

from checks import aborts, check, run, same, true
from wire import Wire, add_arguments, until, word

# Longest time for an answer of a node on a busy test machine, s.
PATIENCE = 3.0


class Module:
    """The node under test, and the contents of its first TPDO."""

    def __init__(self, arguments):
        self.wire = Wire(arguments)
        self.network = self.wire.network
        self.id = arguments.node
        self.node = self.network.add_node(self.id, arguments.eds)
        self.sdo = self.node.sdo
        self.sdo.RESPONSE_TIMEOUT = PATIENCE
        self.states = []
        self.inputs = []
        self.network.subscribe(0x700 + self.id, lambda _, data, __: self.states.append(data[0]))
        self.network.subscribe(0x180 + self.id, lambda _, data, __: self.inputs.append(bytes(data)))

    def fresh(self):
        """Resets the node to its power-on values and to pre-operational."""
        seen = len(self.states)
        self.node.nmt.send_command(0x81)
        true(until(lambda: 0 in self.states[seen:], PATIENCE), "no boot-up")
        self.node.emcy.reset()
        self.inputs.clear()

    def start(self):
        """Starts the node and takes its first event-driven TPDO."""
        self.node.nmt.send_command(0x01)
        self.hears(bytes(8))

    def hears(self, data):
        true(until(lambda: data in self.inputs, PATIENCE), f"no TPDO {data.hex()}, but {self.inputs}")
        self.inputs.clear()

    def read(self, index, subindex):
        return int.from_bytes(self.sdo.upload(index, subindex), "little")

    def write(self, index, subindex, value, size=1):
        self.sdo.download(index, subindex, word(value, size))


@check
def a_search_finds_the_node(m):
    m.fresh()
    m.network.scanner.reset()
    m.network.scanner.search(limit=16)
    true(until(lambda: m.id in m.network.scanner.nodes, PATIENCE), "not found")


@check
def the_device_type_is_cia_401_with_inputs_and_outputs(m):
    same(m.read(0x1000, 0), 0x0003_0191)
    same(m.sdo.upload(0x1008, 0), b"Digital I/O")


@check
def every_object_of_the_eds_has_its_default(m):
    seen = 0
    for entry in m.node.object_dictionary.values():
        if entry.index < 0x1000:
            continue
        variables = [entry] if isinstance(entry, canopen.objectdictionary.ODVariable) else list(entry.values())
        for variable in variables:
            if variable.default is None or variable.index == 0x1003:
                continue
            value = variable.decode_raw(m.sdo.upload(variable.index, variable.subindex))
            same(value, variable.default, f"{variable.index:04X}:{variable.subindex:02X}")
            seen += 1
    true(seen > 150, f"only {seen} objects")


@check
def the_number_of_lines_is_in_the_dictionary(m):
    same(m.read(0x6000, 0), 8)
    same(m.read(0x6200, 0), 8)
    aborts(0x06090011, lambda: m.sdo.upload(0x6000, 9))


@check
def an_output_by_sdo_is_an_input(m):
    m.fresh()
    m.write(0x6200, 3, 0x5A)
    true(until(lambda: m.read(0x6000, 3) == 0x5A, PATIENCE), "the input does not follow")


@check
def an_rpdo_sets_outputs_and_a_tpdo_tells_inputs(m):
    m.fresh()
    m.start()
    rpdo = m.node.rpdo[1]
    rpdo.read()
    same(len(rpdo.map), 8)
    rpdo.map[0].raw = 0x81
    rpdo.map[7].raw = 0x10
    rpdo.transmit()
    m.hears(bytes([0x81, 0, 0, 0, 0, 0, 0, 0x10]))
    same(m.read(0x6200, 8), 0x10)


@check
def a_mapping_of_the_masters_choice_carries_single_bytes(m):
    m.fresh()
    tpdo, rpdo = m.node.tpdo[1], m.node.rpdo[1]
    for pdo, index in ((tpdo, 0x6000), (rpdo, 0x6200)):
        pdo.read()
        pdo.clear()
        pdo.add_variable(index, 2)
        pdo.trans_type = 255
        pdo.inhibit_time = pdo.event_timer = None
        pdo.enabled = True
        pdo.save()
    m.node.nmt.send_command(0x01)
    m.hears(b"\x00")
    rpdo.map[0].raw = 0x3C
    rpdo.transmit()
    m.hears(b"\x3C")
    # The node keeps the mapping until the next reset.
    m.fresh()
    tpdo.read()
    rpdo.read()
    same(len(tpdo.map), 8)


@check
def interrupt_masks_select_the_edges(m):
    m.fresh()
    for byte in range(1, 9):
        m.write(0x6006, byte, 0)
    m.write(0x6007, 1, 0x01)
    m.start()
    # A rising edge of input 1 is not selected, one of input 0 is.
    m.write(0x6200, 1, 0x02)
    m.write(0x6200, 1, 0x03)
    m.hears(bytes([0x03, 0, 0, 0, 0, 0, 0, 0]))
    m.write(0x6200, 1, 0x00)
    same(m.read(0x6000, 1), 0)
    same(m.inputs, [])


@check
def a_synchronous_tpdo_waits_for_sync(m):
    m.fresh()
    m.write(0x1800, 1, 0xC000_0180 + m.id, 4)
    m.write(0x1800, 2, 1)
    m.write(0x1800, 1, 0x4000_0180 + m.id, 4)
    m.node.nmt.send_command(0x01)
    m.write(0x6200, 1, 0x01)
    same(m.read(0x6000, 1), 1)
    same(m.inputs, [])
    m.network.sync.transmit()
    m.hears(bytes([0x01, 0, 0, 0, 0, 0, 0, 0]))


@check
def a_lost_heartbeat_is_an_emcy_and_sets_the_error_value(m):
    m.fresh()
    m.write(0x6207, 1, 0xF0)
    m.write(0x6206, 1, 0x3C)
    m.write(0x1016, 1, 127 << 16 | 200, 4)
    m.write(0x1017, 0, 50, 2)
    m.start()
    m.write(0x6200, 1, 0x55)
    m.wire.send(0x77F, "05")
    found = lambda: [it for it in m.node.emcy.log if it.code == 0x8130]
    true(until(found, PATIENCE), "no EMCY 0x8130")
    same(found()[-1].register, 0x11)
    # Bits 2 to 5 have the error value, the others keep their level.
    true(until(lambda: m.read(0x6000, 1) == 0x71, PATIENCE), "no error value")
    true(until(lambda: m.states[-1] == 0x7F, PATIENCE), "not pre-operational")
    m.fresh()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    arguments = parser.parse_args()
    m = Module(arguments)
    failed = run(m, m.wire)
    m.network.disconnect()
    return 1 if failed else 0


sys.exit(main())
