"""python-canopen's block transfer with a server that has one long object, 0x2F00.

Prints each failure with the last frames, and nothing else. The exit status is 1 after a failure.
"""

import argparse
import random
import sys
import traceback

import canopen

from wire import Wire, add_arguments

# Segments hold 7 bytes, sub-blocks 127 segments; 1022 bytes are the capacity of the server.
SIZES = [1, 4, 5, 6, 7, 8, 13, 14, 15, 28, 29, 35, 36, 70, 888, 889, 890, 1021, 1022]
LONGEST = 1022


def transfer(sdo, data, checksum):
    with sdo.open(0x2F00, 0, "wb", size=len(data), block_transfer=True, request_crc_support=checksum) as stream:
        stream.write(data)
    with sdo.open(0x2F00, 0, "rb", block_transfer=True, request_crc_support=checksum) as stream:
        read = stream.read()
    if read != data:
        raise RuntimeError(f"{len(data)} bytes, checksum {checksum}: {read.hex()} instead of {data.hex()}")
    # The same value by ordinary transfer.
    if sdo.upload(0x2F00, 0) != data:
        raise RuntimeError(f"{len(data)} bytes by segments differ")


def refused(code, call):
    try:
        call()
    except canopen.SdoAbortedError as abort:
        if abort.code != code:
            raise RuntimeError(f"aborted by {abort.code:#010x}, expected {code:#010x}")
    else:
        raise RuntimeError(f"not aborted, expected {code:#010x}")


def judge(wire, node):
    sdo = wire.network.add_node(node, canopen.ObjectDictionary()).sdo
    sdo.RESPONSE_TIMEOUT = 3.0
    bytes_of = random.Random(1).randbytes
    for size in SIZES:
        for checksum in (True, False):
            transfer(sdo, bytes_of(size), checksum)
    opened = lambda index, mode, **more: lambda: sdo.open(index, 0, mode, block_transfer=True, **more)
    refused(0x06020000, opened(0x2F01, "rb"))
    refused(0x05040005, opened(0x2F00, "wb", size=LONGEST + 1))
    # A wrong checksum.
    keep = bytes_of(7)
    transfer(sdo, keep, True)
    stream = sdo.open(0x2F00, 0, "wb", buffering=0, size=7, block_transfer=True)
    stream.write(bytes(7))
    stream._crc.process(b"wrong")
    refused(0x05040004, stream.close)
    if sdo.upload(0x2F00, 0) != keep:
        raise RuntimeError("data of a wrong checksum were kept")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    add_arguments(parser)
    arguments = parser.parse_args()
    wire = Wire(arguments)
    try:
        judge(wire, arguments.node)
    except Exception:
        traceback.print_exc(file=sys.stdout)
        print(*wire.last, sep="\n")
        return 1
    finally:
        wire.network.disconnect()
    return 0


sys.exit(main())
