"""python-canopen as the master of an emulated force/torque sensor with a constant load and no noise.

Each check is a claim, printed with `ok` or with `FAILED`, the reason and the last frames. The exit status is 1 after a
failure.
"""

import argparse
import sys

import canopen

from checks import aborts, check, run, same, true
from wire import Wire, add_arguments, until, word

# Longest time for an answer of a node on a busy test machine, s.
PATIENCE = 3.0
NAMES = ["Force x", "Force y", "Force z", "Torque x", "Torque y", "Torque z"]


class Sensor:
    """The node under test, and its load, N and N·m."""

    def __init__(self, arguments):
        self.wire = Wire(arguments)
        self.network = self.wire.network
        self.id = arguments.node
        self.load = arguments.load
        self.node = self.network.add_node(self.id, arguments.eds)
        self.sdo = self.node.sdo
        self.sdo.RESPONSE_TIMEOUT = PATIENCE
        self.states = []
        self.network.subscribe(0x700 + self.id, lambda _, data, __: self.states.append(data[0]))
        # Data of the TPDOs of forces and of torques.
        self.forces, self.torques = [], []
        self.network.subscribe(0x180 + self.id, lambda _, data, __: self.forces.append(bytes(data)))
        self.network.subscribe(0x280 + self.id, lambda _, data, __: self.torques.append(bytes(data)))

    def fresh(self):
        """Resets the node to its power-on values and to pre-operational."""
        seen = len(self.states)
        self.node.nmt.send_command(0x81)
        true(until(lambda: 0 in self.states[seen:], PATIENCE), "no boot-up")

    def sync(self):
        """Sends SYNC and returns the data of the next TPDOs."""
        self.forces.clear()
        self.torques.clear()
        self.network.sync.transmit()
        true(until(lambda: self.forces and self.torques, PATIENCE), f"after SYNC: {self.forces}, {self.torques}")
        return self.forces[0], self.torques[0]

    def counts(self, bits):
        """The load in counts."""
        force, torque = (self.sdo[0x2004][sub].raw * 1e-6 for sub in ((1, 2) if bits == 16 else (3, 4)))
        return [round(value / scale) for value, scale in zip(self.load, [force] * 3 + [torque] * 3)]


def signed(data, size):
    return [int.from_bytes(data[at : at + size], "little", signed=True) for at in range(0, len(data), size)]


@check
def every_object_of_the_eds_has_its_default(s):
    s.fresh()
    seen = 0
    for entry in s.node.object_dictionary.values():
        if entry.index < 0x1000:
            continue
        variables = [entry] if isinstance(entry, canopen.objectdictionary.ODVariable) else list(entry.values())
        for variable in variables:
            if variable.default is None or variable.index == 0x1003:
                continue
            value = variable.decode_raw(s.sdo.upload(variable.index, variable.subindex))
            same(value, variable.default, f"{variable.index:04X}:{variable.subindex:02X}")
            seen += 1
    true(seen > 100, f"only {seen} objects")


@check
def the_readings_are_the_load_in_their_scale(s):
    for bits, index in ((16, 0x2000), (32, 0x2001)):
        found = [s.sdo[f"Wrench {bits}-bit"][f"{name} {bits}-bit"].raw for name in NAMES]
        same(found, s.counts(bits), f"{bits} bits")
        same([s.sdo[index][sub].raw for sub in range(1, 7)], found, f"{index:04X}")
    same(s.sdo["Sensor status"].raw, 0)
    same(s.sdo["Temperature"].raw, 250)


@check
def readings_cannot_be_written(s):
    aborts(0x06010002, lambda: s.sdo.download(0x2000, 1, b"\0\0"))
    aborts(0x06090030, lambda: s.sdo.download(0x2003, 0, b"\2"))
    aborts(0x06090011, lambda: s.sdo.upload(0x2000, 7))


@check
def two_tpdos_carry_forces_and_torques_after_each_sync(s):
    s.fresh()
    s.node.nmt.send_command(0x01)
    for _ in range(5):
        forces, torques = s.sync()
        same(signed(forces, 2) + signed(torques, 2), s.counts(16))


@check
def a_mapping_of_the_masters_choice_carries_32_bits_and_status(s):
    s.fresh()
    first, second = s.node.tpdo[1], s.node.tpdo[2]
    for pdo, objects in ((first, [(0x2001, 3), (0x2002, 0)]), (second, [(0x2001, 6), (0x2001, 1)])):
        pdo.read()
        pdo.clear()
        for index, subindex in objects:
            pdo.add_variable(index, subindex)
        pdo.enabled = True
        pdo.save()
    s.node.nmt.send_command(0x01)
    one, two = s.sync()
    same((len(one), len(two)), (6, 8))
    counts = s.counts(32)
    same(signed(one[:4], 4) + signed(two, 4), [counts[2], counts[5], counts[0]])
    same(one[4:], b"\0\0", "status")


@check
def the_event_timer_sends_without_sync(s):
    s.fresh()
    for sub, value, size in ((1, 0xC000_0180 + s.id, 4), (2, 255, 1), (5, 10, 2), (1, 0x4000_0180 + s.id, 4)):
        s.sdo.download(0x1800, sub, word(value, size))
    s.forces.clear()
    s.node.nmt.send_command(0x01)
    true(until(lambda: len(s.forces) >= 20, PATIENCE), f"only {len(s.forces)} TPDOs")
    same({tuple(signed(data, 2)) for data in s.forces}, {tuple(s.counts(16)[:3])})


@check
def the_bias_makes_the_load_zero_until_a_reset_of_the_node(s):
    s.fresh()
    s.node.nmt.send_command(0x01)
    s.sdo["Bias"].raw = 1
    same(s.sync(), (bytes(6), bytes(6)))
    s.sdo["Bias"].raw = 0
    same(signed(s.sync()[0], 2), s.counts(16)[:3])
    s.sdo["Bias"].raw = 1
    s.fresh()
    same(s.sdo["Bias"].raw, 0)
    same(s.sdo[0x2000][1].raw, s.counts(16)[0])


@check
def the_heartbeat_shows_the_state(s):
    s.fresh()
    s.sdo.download(0x1017, 0, word(20, 2))
    for command, state in ((0x01, 0x05), (0x02, 0x04), (0x80, 0x7F)):
        s.node.nmt.send_command(command)
        s.states.clear()
        true(until(lambda: state in s.states, PATIENCE), f"states {s.states}, expected {state:#x}")
    s.fresh()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    parser.add_argument("--load", type=float, nargs=6, required=True, help="wrench on the sensor, N and N·m")
    arguments = parser.parse_args()
    s = Sensor(arguments)
    failed = run(s, s.wire)
    s.network.disconnect()
    return 1 if failed else 0


sys.exit(main())
