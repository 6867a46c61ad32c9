"""Rate of expedited SDO uploads of python-canopen: as a client of a node on a bus, or of its own server.

Prints one JSON object. Without --interface, client and server are two networks on python-can's virtual bus.
"""

import argparse
import json
import time

import can
import canopen

from wire import open_bus

DEVICE_TYPE = bytes.fromhex("92010200")


def network(bus):
    network = canopen.Network(bus)
    network.connect()
    return network


def rate(sdo, seconds):
    """Number of uploads of object 0x1000 per second; each value is checked."""
    def upload(until):
        count = 0
        while time.perf_counter() < until:
            if sdo.upload(0x1000, 0) != DEVICE_TYPE:
                raise RuntimeError("not what object 0x1000 says")
            count += 1
        return count

    sdo.RESPONSE_TIMEOUT = 2.0
    upload(time.perf_counter() + min(0.2, seconds))
    begin = time.perf_counter()
    count = upload(begin + seconds)
    return count / (time.perf_counter() - begin)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--interface", help="python-can's")
    parser.add_argument("--channel", default="peers")
    parser.add_argument("--node", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=2.0)
    arguments = parser.parse_args()
    dictionary = canopen.ObjectDictionary()
    device_type = canopen.objectdictionary.ODVariable("device type", 0x1000)
    device_type.data_type = canopen.objectdictionary.UNSIGNED32
    device_type.access_type = "ro"
    device_type.default = int.from_bytes(DEVICE_TYPE, "little")
    dictionary.add_object(device_type)
    networks = []
    if arguments.interface:
        networks.append(network(open_bus(arguments)))
    else:
        for _ in range(2):
            networks.append(network(can.Bus(interface="virtual", channel=arguments.channel)))
        networks[1].add_node(canopen.LocalNode(arguments.node, dictionary))
    node = networks[0].add_node(arguments.node, dictionary)
    found = rate(node.sdo, arguments.seconds)
    for it in networks:
        it.disconnect()
    print(json.dumps({"uploads_per_second": found}))


main()
