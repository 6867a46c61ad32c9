"""python-canopen as the master of one emulated axis controller.

Each check is a claim, printed with `ok` or with `FAILED`, the reason and the last frames. The exit status is 1 after a failure.
The cell must leave the axis room for one turn in each direction.
"""

import argparse
import sys
import time

import canopen
from canopen.profiles.p402 import BaseNode402

from checks import Failed, aborts, check, run, same, true
from wire import Wire, add_arguments, until, word

# Longest time for an answer of a node on a busy test machine, s.
PATIENCE = 3.0
# Counts per revolution of the axis.
TURN = 4000


class Master:
    """Master of the node under test."""

    def __init__(self, arguments):
        self.wire = Wire(arguments)
        self.network = self.wire.network
        self.node = BaseNode402(arguments.node, canopen.import_od(arguments.eds, arguments.node))
        self.network.add_node(self.node)
        self.node.sdo.RESPONSE_TIMEOUT = PATIENCE
        # The default time limits are too short here, because the whole machine may pause.
        for name in ("RESET_FAULT", "SWITCH_OP_MODE", "SWITCH_STATE_FINAL", "SWITCH_STATE_SINGLE", "CHECK_TPDO"):
            setattr(self.node, f"TIMEOUT_{name}", PATIENCE)
        self.id = arguments.node
        self.sdo = self.node.sdo
        self.heartbeats = []
        self.network.subscribe(0x700 + self.id, lambda _, data, at: self.heartbeats.append((at, data[0])))

    def boots_by(self, command):
        seen = len(self.heartbeats)
        self.node.nmt.send_command(command)
        true(until(lambda: (0,) in [it[1:] for it in self.heartbeats[seen:]], PATIENCE), "no boot-up")

    def fresh(self):
        """Resets the node to its power-on values and to pre-operational."""
        self.synchronise(None)
        self.boots_by(0x81)
        self.node.emcy.reset()
        self.node.tpdo_values.clear()
        self.node.tpdo_pointers.clear()
        self.node.rpdo_pointers.clear()

    def synchronise(self, period):
        """Sends SYNC with this period, s; None stops SYNC."""
        if self.network.sync.period:
            self.network.sync.stop()
            self.network.sync.period = None
        if period:
            self.network.sync.start(period)

    def emergency(self, code):
        """Waits for the emergency with this code, unless it was received already."""
        found = lambda: [it for it in self.node.emcy.log if it.code == code]
        true(until(found, PATIENCE), f"no EMCY {code:#06x}")
        return found()[-1]

    def hears(self, state, timeout=PATIENCE):
        seen = len(self.heartbeats)
        return until(lambda: state in [it[1] for it in self.heartbeats[seen:]], timeout)

    def read(self, index, subindex=0):
        variable = self.node.object_dictionary.get_variable(index, subindex)
        return variable.decode_raw(self.sdo.upload(index, subindex))

    def write(self, index, subindex, value, size):
        self.sdo.download(index, subindex, word(value, size))

    def map(self, pdo, transmission, *objects):
        """Maps a PDO in the sequence that CiA 301 requires, with the code of canopen."""
        pdo.read()
        pdo.clear()
        for entry in objects:
            pdo.add_variable(*entry)
        pdo.trans_type = transmission
        pdo.inhibit_time = pdo.event_timer = None
        pdo.enabled = True
        pdo.save()


@check
def reset_node_boots_into_pre_operational(m):
    m.fresh()
    same(m.node.nmt.state, "PRE-OPERATIONAL")


@check
def a_search_finds_the_node(m):
    m.network.scanner.reset()
    m.network.scanner.search(limit=16)
    true(until(lambda: m.id in m.network.scanner.nodes, PATIENCE), "not found")


@check
def every_object_of_the_eds_has_its_size_and_its_default(m):
    # Values that differ between units and are not in the EDS: identity, motor, switches, supply, position.
    of_the_unit = {0x1018, 0x2200, 0x3001, 0x3141, 0x6041, 0x6062, 0x6064, 0x6076, 0x60F4, 0x60FD}
    changing = of_the_unit | {0x30D1, 0x606B, 0x606C, 0x6061, 0x6077}
    errors, seen = [], 0
    for entry in m.node.object_dictionary.values():
        if entry.index < 0x1000:
            continue
        variables = [entry] if isinstance(entry, canopen.objectdictionary.ODVariable) else list(entry.values())
        for variable in variables:
            at = f"{variable.index:04X}:{variable.subindex:02X}"
            if not variable.readable:
                continue
            try:
                data = m.sdo.upload(variable.index, variable.subindex)
            except canopen.SdoAbortedError as abort:
                if not (variable.index == 0x1003 and abort.code == 0x08000024):
                    errors.append(f"{at}: {abort}")
                continue
            seen += 1
            if variable.fixed_size and len(data) != len(variable) // 8:
                errors.append(f"{at}: {len(data)} bytes of {len(variable) // 8}")
            elif variable.index not in changing and variable.default is not None:
                value = variable.decode_raw(data)
                if value != variable.default:
                    errors.append(f"{at}: {value!r}, the EDS says {variable.default!r}")
    true(seen > 50, f"only {seen} objects")
    true(not errors, "; ".join(errors))


@check
def objects_of_every_size_are_written_and_read_back(m):
    for index, subindex, size, value in [
        (0x6098, 0, 1, 37),
        (0x6098, 0, 1, 0xFD),
        (0x1017, 0, 2, 0x1234),
        (0x6081, 0, 4, 0x0BCD_EF01),
    ]:
        m.write(index, subindex, value, size)
        same(m.sdo.upload(index, subindex), word(value, size), f"{index:04X}")
    m.write(0x1017, 0, 0, 2)
    same(m.read(0x6098), -3)


@check
def expedited_answers_are_those_of_cia_301(m):
    node = m.id
    for request, answer in [
        ("4000100000000000", "4300100092010200"),
        ("4001100000000000", "4F01100000000000"),
        ("4017100000000000", "4B17100000000000"),
        ("2381600078563412", "6081600000000000"),
        ("4081600000000000", "4381600078563412"),
        # The size is not given, because the server knows the size of the object.
        ("2298600025000000", "6098600000000000"),
        ("4098600000000000", "4F98600025000000"),
    ]:
        same(m.wire.ask(node, request, PATIENCE), answer, request)


@check
def a_text_is_uploaded_in_segments(m):
    with m.sdo.open(0x1008, 0, buffering=0) as stream:
        same(stream.exp_data, None, "expedited data")
        same(stream.size, 5, "announced size")
        same(stream.readall(), b"EPOS4")
    same(m.wire.ask(m.id, "4008100000000000", PATIENCE), "4108100005000000")
    same(m.wire.ask(m.id, "6000000000000000", PATIENCE), "0545504F53340000")


@check
def a_number_is_downloaded_in_segments(m):
    m.sdo.download(0x6081, 0, word(4321, 4), force_segment=True)
    same(m.read(0x6081), 4321)
    with m.sdo.open(0x6081, 0, "wb", buffering=7, size=None) as stream:
        stream.write(word(1234, 4))
    same(m.read(0x6081), 1234)
    aborts(0x06070010, lambda: m.sdo.download(0x6081, 0, bytes(14)))
    aborts(0x06070013, lambda: m.sdo.download(0x6081, 0, bytes(3), force_segment=True))
    same(m.read(0x6081), 1234)


@check
def blocks_carry_long_objects_both_ways(m):
    with m.sdo.open(0x2FF0, 1, "rb", block_transfer=True) as stream:
        text = stream.read()
    same(text, m.sdo.upload(0x2FF0, 1), "object 2FF0:1")
    # At most 32 consecutive segments, the queue of an adapter, because python-canopen does not recover lost segments.
    data = bytes(range(200))
    def download(subindex, data):
        with m.sdo.open(0x2FF0, subindex, "wb", size=len(data), block_transfer=True) as stream:
            stream.write(data)

    download(2, data)
    with m.sdo.open(0x2FF0, 2, "rb", block_transfer=True) as stream:
        same(stream.read(), data, "object 2FF0:2")
    aborts(0x06020000, lambda: m.sdo.open(0x5FFF, 0, "rb", block_transfer=True))
    aborts(0x06010002, lambda: download(1, bytes(9)))


@check
def refusals_have_the_codes_of_an_epos4(m):
    write = lambda index, sub, value, size: lambda: m.write(index, sub, value, size)
    read = lambda index, sub: lambda: m.sdo.upload(index, sub)
    for code, call in [
        (0x06020000, read(0x5FFF, 0)),
        (0x06020000, write(0x5FFF, 0, 0, 1)),
        (0x06090011, read(0x1018, 9)),
        (0x06010002, write(0x1000, 0, 0, 4)),
        (0x06010002, write(0x6041, 0, 0, 2)),
        (0x06070010, write(0x6040, 0, 0, 4)),
        (0x06070013, write(0x6081, 0, 0, 2)),
        (0x06090030, write(0x60C2, 1, 200, 1)),
        (0x06090030, write(0x6007, 0, -1, 2)),
        (0x06090030, write(0x1003, 0, 1, 1)),
        (0x08000024, read(0x1003, 1)),
    ]:
        aborts(code, call)
    # A mapping of a missing object, a mapping of a wrong length, and a mapping under a count other than 0.
    m.write(0x1800, 1, 0xC000_0180 + m.id, 4)
    m.write(0x1A00, 0, 0, 1)
    aborts(0x06020000, write(0x1A00, 1, 0x5FFF0010, 4))
    aborts(0x06040041, write(0x1A00, 1, 0x60400020, 4))
    aborts(0x06040041, write(0x1A00, 1, 0x10170010, 4))
    for sub in (1, 2, 3):
        m.write(0x1A00, sub, 0x60640020, 4)
    aborts(0x06040042, write(0x1A00, 0, 3, 1))
    m.write(0x1A00, 0, 2, 1)
    aborts(0x06010003, write(0x1A00, 1, 0x60410010, 4))


@check
def broken_transfers_are_aborted_and_the_next_one_works(m):
    node = m.id
    for requests, answer in [
        (["E000000000000000"], "8000000001000405"),
        # No transfer is under way.
        (["6000000000000000"], "8000000001000405"),
        # The toggle bit must begin at 0.
        (["4008100000000000", "7000000000000000"], "8008100000000305"),
        (["2181600004000000", "1701000000000000"], "8081600000000305"),
    ]:
        for request in requests:
            last = m.wire.ask(node, request, PATIENCE)
        same(last, answer, requests[-1])
    m.wire.ask(node, "4008100000000000", PATIENCE)
    m.wire.send(0x600 + node, "8008100000000008")
    same(m.read(0x1000), 0x0002_0192)


@check
def states_follow_nmt_commands_and_show_in_heartbeats(m):
    m.fresh()
    m.write(0x1017, 0, 20, 2)
    for command, state in [(1, 5), (128, 127), (1, 5), (2, 4), (128, 127)]:
        m.node.nmt.send_command(command)
        true(m.hears(state), f"no heartbeat of state {state}")
    # Addressed to all nodes.
    m.network.nmt.send_command(1)
    true(m.hears(5), "the command to all nodes was not obeyed")
    m.network.nmt.send_command(128)
    true(m.hears(127), "the command to all nodes was not obeyed")


@check
def a_stopped_node_answers_no_sdo(m):
    m.node.nmt.send_command(2)
    same(m.wire.ask(m.id, "4000100000000000", 0.3), None)
    m.node.nmt.send_command(128)
    same(m.read(0x1000), 0x0002_0192)


@check
def heartbeats_come_at_their_period(m):
    m.write(0x1017, 0, 20, 2)
    seen = len(m.heartbeats)
    true(until(lambda: len(m.heartbeats) > seen + 50, PATIENCE), "too few heartbeats")
    times = [at for at, _ in m.heartbeats[seen:]]
    # A machine delivers several heartbeats at once after a pause, so the mean period is measured.
    period = (times[50] - times[0]) / 50
    true(0.015 < period < 0.026, f"a period of {period * 1e3:.1f} ms")
    m.write(0x1017, 0, 0, 2)
    time.sleep(0.05)
    seen = len(m.heartbeats)
    time.sleep(0.1)
    same(len(m.heartbeats), seen, "heartbeats of a silenced producer")


@check
def resets_restore_what_they_should(m):
    m.write(0x1017, 0, 50, 2)
    m.write(0x6081, 0, 777, 4)
    m.boots_by(0x82)
    same(m.read(0x1017), 0, "heartbeat time after reset communication")
    same(m.read(0x6081), 777, "profile velocity after reset communication")
    m.boots_by(0x81)
    same(m.read(0x6081), 1000, "profile velocity after reset node")


@check
def layer_settings_find_the_node_and_renumber_it(m):
    lss, other = m.network.lss, 0x21
    lss.RESPONSE_TIMEOUT = PATIENCE
    identity = [m.read(0x1018, sub) for sub in (1, 2, 3, 4)]
    booted = []
    for node in (m.id, other):
        m.network.subscribe(0x700 + node, lambda identifier, data, _: data[0] or booted.append(identifier - 0x700))
    for present, wanted in ((m.id, other), (other, m.id)):
        true(lss.send_switch_state_selective(*identity), "not selected by its identity")
        same(lss.inquire_node_id(), present, "node-ID")
        for specifier, number in zip((0x5A, 0x5B, 0x5C, 0x5D), identity):
            same(lss.inquire_lss_address(specifier), number, f"answer to {specifier:#x}")
        try:
            lss.configure_node_id(200)
        except canopen.lss.LssError:
            pass
        else:
            raise Failed("took node-ID 200")
        lss.configure_node_id(wanted)
        lss.send_switch_state_global(lss.WAITING_STATE)
        booted.clear()
        m.network.send_message(0, [0x82, present])
        true(until(lambda: booted == [wanted], PATIENCE), f"booted as {booted}, expected {wanted}")
        same(m.wire.ask(wanted, "4000100000000000", PATIENCE), "4300100092010200")


@check
def a_lost_heartbeat_is_an_emergency_that_ends(m):
    m.fresh()
    host = 0x7A
    m.write(0x1016, 1, host << 16 | 500, 4)
    beat = lambda: m.wire.send(0x700 + host, "05")
    beat()
    error = m.emergency(0x8130)
    same(error.register & 0x11, 0x11, "error register")
    same(m.read(0x1001), error.register, "object 1001")
    same(m.read(0x1003, 1) & 0xFFFF, 0x8130, "object 1003:1")
    same(len(m.node.emcy.active), 1, "active errors")
    beat()
    true(until(lambda: not m.node.emcy.active, PATIENCE), "no EMCY 0x0000")
    same(m.node.emcy.log[-1].code, 0, "last EMCY")
    # The watch ends before the heartbeat is lost again.
    m.write(0x1016, 1, 0, 4)
    m.write(0x1003, 0, 0, 1)
    aborts(0x08000024, lambda: m.read(0x1003, 1))
    m.fresh()


@check
def a_pdo_too_short_is_an_emergency(m):
    m.node.nmt.send_command(1)
    m.wire.send(0x200 + m.id, "06")
    same(m.emergency(0x8210).register & 0x11, 0x11, "error register")
    same(m.read(0x6040), 0, "controlword")
    m.fresh()


@check
def a_synchronous_tpdo_carries_what_sdo_reads(m):
    m.fresh()
    tpdo = m.node.tpdo[1]
    m.map(tpdo, 1, (0x6041,), (0x6064,))
    m.node.nmt.send_command(1)
    for _ in range(5):
        tpdo.is_received = False
        m.network.sync.transmit()
        true(until(lambda: tpdo.is_received, PATIENCE), "no TPDO after SYNC")
    same(len(tpdo.data), 6, "length")
    same(tpdo[0x6064].raw, m.read(0x6064), "position")
    same(tpdo[0x6041].raw, m.read(0x6041), "statusword")


@check
def every_nth_sync_is_answered(m):
    tpdo = m.node.tpdo[1]
    m.node.nmt.send_command(128)
    m.map(tpdo, 3, (0x6064,), (0x606C,))
    m.node.nmt.send_command(1)
    received = []
    tpdo.add_callback(lambda it: received.append(it.timestamp))
    for _ in range(9):
        m.network.sync.transmit()
        time.sleep(0.01)
    true(until(lambda: len(received) >= 3, PATIENCE), f"{len(received)} TPDOs for 9 SYNCs, expected 3")
    time.sleep(0.02)
    same(len(received), 3, "TPDOs for 9 SYNCs")
    tpdo.callbacks.clear()


@check
def an_event_driven_tpdo_comes_when_its_object_changes(m):
    m.fresh()
    tpdo = m.node.tpdo[1]
    tpdo.read()
    m.node.nmt.send_command(1)
    time.sleep(0.05)
    tpdo.is_received = False
    m.write(0x6040, 0, 0x06, 2)
    true(until(lambda: tpdo.is_received and tpdo.data[0] & 0x6F == 0x21, PATIENCE), "no TPDO of ready to switch on")
    m.write(0x6040, 0, 0x00, 2)
    true(until(lambda: tpdo.data[0] & 0x4F == 0x40, PATIENCE), "no TPDO of switch on disabled")


@check
def rpdos_take_effect_at_once_or_with_sync(m):
    rpdo = m.node.rpdo[2]
    m.node.nmt.send_command(128)
    m.map(rpdo, 255, (0x607A,), (0x60FF,))
    m.node.nmt.send_command(1)
    send = lambda value: (setattr(rpdo[0x60FF], "raw", value), rpdo.transmit())
    send(-7)
    same(m.read(0x60FF), -7, "event driven")
    m.node.nmt.send_command(128)
    m.map(rpdo, 1, (0x607A,), (0x60FF,))
    m.node.nmt.send_command(1)
    send(11)
    same(m.read(0x60FF), -7, "before SYNC")
    m.network.sync.transmit()
    same(m.read(0x60FF), 11, "after SYNC")
    m.fresh()


@check
def the_profile_class_switches_on_and_homes(m):
    m.fresh()
    node = m.node
    m.write(0x6098, 0, 37, 1)
    m.map(node.tpdo[1], 1, (0x6041,), (0x6061,))
    m.map(node.rpdo[1], 255, (0x6040,), (0x6060,))
    node.rpdo[1].period = None
    node.setup_402_state_machine()
    node.nmt.send_command(1)
    m.synchronise(0.01)
    true(until(lambda: node.state == "SWITCH ON DISABLED", PATIENCE), node.state)
    # If SYNCs come late and then in a row, python-canopen may take an older statusword for the result of homing.
    true(any(node.homing(timeout=5) for _ in range(5)), f"not homed, statusword {node.statusword:#06x}")
    node.controlword = 0x0F
    same(m.read(0x6064), 0, "position after homing where it stands")


@check
def the_profile_class_moves_the_axis_to_a_point(m):
    node = m.node
    node.op_mode = "PROFILED POSITION"
    same(node.op_mode, "PROFILED POSITION")
    m.write(0x6083, 0, 5000, 4)
    m.write(0x6084, 0, 5000, 4)
    for target in (TURN // 2, -TURN // 2):
        m.write(0x607A, 0, target, 4)
        node.controlword = 0x1F
        true(until(lambda: node.statusword & 0x1000, PATIENCE), "set-point not acknowledged")
        node.controlword = 0x0F
        true(until(lambda: not node.statusword & 0x1000, PATIENCE), "acknowledge not taken back")
        true(until(lambda: node.statusword & 0x0400, PATIENCE), f"target {target} not reached")
        found = m.read(0x6064)
        true(abs(found - target) < 20, f"stands at {found}, target {target}")


@check
def the_profile_class_streams_set_points(m):
    node = m.node
    m.synchronise(None)
    node.nmt.send_command(128)
    time.sleep(0.05)
    m.map(node.tpdo[2], 1, (0x6064,), (0x606C,))
    m.map(node.rpdo[2], 1, (0x607A,))
    m.write(0x60C2, 1, 10, 1)
    begin = m.read(0x6064)
    m.write(0x607A, 0, begin, 4)
    node.nmt.send_command(1)
    m.synchronise(0.01)
    node.op_mode = "CYCLIC SYNCHRONOUS POSITION"
    node.state = "OPERATION ENABLED"
    steps = 100
    seen = []
    node.tpdo[2].add_callback(lambda it: seen.append(it[0x6064].raw))
    for step in range(1, steps + 1):
        true(node.tpdo[2].wait_for_reception(PATIENCE) is not None, "no TPDO")
        node.rpdo[2][0x607A].raw = begin + TURN // 2 * step // steps
        node.rpdo[2].transmit()
    end = begin + TURN // 2
    true(until(lambda: seen and abs(seen[-1] - end) < 20, PATIENCE), f"stands at {seen[-1]}, target {end}")
    true(all(b - a > -20 for a, b in zip(seen, seen[1:])), "the axis went back on its way")
    node.tpdo[2].callbacks.clear()


@check
def a_following_error_is_a_fault_that_is_reset(m):
    node = m.node
    m.node.emcy.reset()
    node.rpdo[2][0x607A].raw = m.read(0x6064) + 50 * TURN
    node.rpdo[2].transmit()
    true(until(lambda: node.state == "FAULT", PATIENCE), f"no fault, {node.state}")
    m.emergency(0x8611)
    same(m.read(0x603F), 0x8611, "error code")
    node.rpdo[2][0x607A].raw = m.read(0x6064)
    node.rpdo[2].transmit()
    node.controlword = 0
    node.controlword = 0x80
    true(until(lambda: node.state == "SWITCH ON DISABLED", PATIENCE), f"not reset, {node.state}")
    true(until(lambda: not node.emcy.active, PATIENCE), "no EMCY 0x0000")
    node.state = "OPERATION ENABLED"


@check
def quick_stop_and_switching_off_work(m):
    node = m.node
    node.state = "QUICK STOP ACTIVE"
    same(node.state, "QUICK STOP ACTIVE")
    node.state = "SWITCH ON DISABLED"
    m.fresh()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    parser.add_argument("--only", help="checks whose name contains this")
    arguments = parser.parse_args()
    m = Master(arguments)
    failed = run(m, m.wire, arguments.only)
    m.synchronise(None)
    m.network.disconnect()
    return 1 if failed else 0


sys.exit(main())
