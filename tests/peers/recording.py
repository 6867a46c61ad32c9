"""The MCAP library and Protobuf read a recording. Arguments: the recording, the CSV file of the same run, and a length.

Every message is decoded by the schema in the file and compared with the CSV file or the candump log beside the recording.
The first bytes of the recording, up to the length, are then read as a recording that was cut.
"""

import csv
import io
import os
import sys

from google.protobuf.unknown_fields import UnknownFieldSet
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap_protobuf.decoder import DecoderFactory

HOMING = {"", "NotHomed", "InProgress", "Attained", "Failed"}


def decoded(stream):
    """Topic, time and content of each message, in the order of the file."""
    reader = NonSeekingReader(stream, decoder_factories=[DecoderFactory()])
    for _, channel, message, content in reader.iter_decoded_messages(log_time_order=False):
        yield channel.topic, message.log_time, content


def check(path, rows):
    with open(path, "rb") as file:
        reader = make_reader(file)
        counts = reader.get_summary().statistics.message_count
        facts = [record.metadata for record in reader.iter_metadata()]
        names = [record.name for record in reader.iter_attachments()]
    assert facts[0]["bench"] == "lockstep" and names[0].endswith(".toml"), (facts, names)

    cycles, frames, total = [], [], 0
    with open(path, "rb") as file:
        for topic, time, content in decoded(file):
            total += 1
            assert len(UnknownFieldSet(content)) == 0, (topic, content)
            if topic.startswith("/robot/"):
                cycles.append((time, content))
            if topic.startswith("/bus/") and content.kind in ("sent", "received"):
                frames.append(content)
    assert total == counts, (total, counts)

    values = [(time, cycle, axis) for time, cycle in cycles for axis in cycle.axis]
    assert len(values) == len(rows) > 1000, (len(values), len(rows))
    for (time, cycle, axis), row in zip(values, rows):
        assert cycle.cycle == int(row["cycle"]) and cycle.phase == row["phase"], (cycle, row)
        assert abs(time / 1e9 - float(row["time_s"])) < 1e-8, (time, row)
        assert axis.homing == row["homing"] and axis.homing in HOMING, (axis, row)
        assert axis.increments == int(row["counts"]), (axis, row)
        numbers = (axis.commanded, axis.measured, axis.velocity, axis.torque)
        given = ("commanded_rad", "measured_rad", "velocity_rad_per_s", "torque_nm")
        assert numbers == tuple(float(row[name]) for name in given), (axis, row)

    with open(os.path.splitext(path)[0] + ".log") as log:
        lines = [line.split() for line in log]
    assert len(lines) == len(frames) > 1000, (len(lines), len(frames))
    for line, frame in zip(lines, frames):
        name, _, data = line[2].partition("#")
        assert int(name, 16) == frame.id and bytes.fromhex(data) == frame.data, (line, frame)
        assert (line[3] == "T") == frame.sending, (line, frame)
    return total


def cut(path, length):
    with open(path, "rb") as file:
        beginning = file.read(length)
    count = 0
    try:
        for _ in decoded(io.BytesIO(beginning)):
            count += 1
    except (McapError, EOFError):
        pass
    return count


def main():
    path, table, length = sys.argv[1], sys.argv[2], int(sys.argv[3])
    with open(table, newline="") as file:
        rows = list(csv.DictReader(file))
    total = check(path, rows)
    count = cut(path, length)
    assert 0.6 * total < count < total, (count, total)
    print(f"{total} messages, {count} of the cut recording")


main()
