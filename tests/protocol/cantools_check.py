#!/usr/bin/env python3
"""Holds leafbench's codec against cantools (PyPI), an independent reader of firmware-protocol.dbc, in both directions.

Frames that cantools encodes (with a CRC-8 written here from the document) must be byte for byte what leafbench
encodes, and frames that leafbench encodes must decode in cantools to the same fields.

    pip install cantools
    python3 tests/protocol/cantools_check.py
"""

import json
import os
import pathlib
import random
import subprocess
import tempfile

import cantools

ROOT = pathlib.Path(__file__).resolve().parents[2]
# Data ids: high byte by message, low byte the node (1 in the DBC).
KINDS = {"SAMPLE": 0x51, "STATUS": 0x52, "EMERGENCY": 0x53, "COMMAND": 0xA1, "LEASE": 0xA2, "REQUEST": 0xA3}
NODE = 1
# The test of leafbench that reads and writes the frames.
EXCHANGE = "tests::protocol::exchange::frames_of_both"
ABORT_CODES = [0x06020000, 0x06090011, 0x06010002, 0x06090030, 0x08000022, 0x05040001]


def crc8(data):
    """CRC-8 0x2F, start 0xFF, final xor 0xFF, bit by bit."""
    crc = 0xFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = ((crc << 1) ^ 0x2F) & 0xFF if crc & 0x80 else crc << 1
    return crc ^ 0xFF


def seal(name, data):
    """The frame with its CRC-8 where the message has one."""
    if name not in KINDS:
        return data
    identity = bytes([NODE, KINDS[name]])
    if name == "EMERGENCY":
        return data[:7] + bytes([crc8(identity + data[:7])])
    return bytes([crc8(identity + data[1:])]) + data[1:]


def any_fields(message, source):
    """Raw values that the document allows."""
    fields = {}
    for signal in message.signals:
        if signal.choices and not signal.is_signed:
            fields[signal.name] = source.choice(list(signal.choices))
        else:
            low = round(signal.minimum / float(signal.scale))
            high = round(signal.maximum / float(signal.scale))
            fields[signal.name] = source.choice([low, high, source.randint(low, high)])
    if message.name == "NMT":
        fields["node"] = source.choice([0, NODE])
    if message.name == "CONFIG_REQUEST" and fields["command"] == 0x40:
        fields["value"] = 0
    if message.name == "CONFIG_ANSWER" and fields["command"] == 0x60:
        fields["value"] = 0
    if message.name == "CONFIG_ANSWER" and fields["command"] == 0x80:
        fields["value"] = source.choice(ABORT_CODES)
    return fields


def encode(message, fields):
    """cantools' bytes for raw fields, sealed."""
    data = message.encode(fields | ({"crc": 0} if message.name in KINDS else {}), scaling=False)
    return seal(message.name, data)


def main():
    assert crc8(b"123456789") == 0xDF
    database = cantools.database.load_file(ROOT / "firmware-protocol.dbc")
    source = random.Random(1)
    with tempfile.TemporaryDirectory() as folder:
        lines = []
        for message in database.messages:
            for _ in range(500):
                fields = any_fields(message, source)
                fields.pop("crc", None)
                line = {"name": message.name, "id": message.frame_id, "hex": encode(message, fields).hex()}
                lines.append(json.dumps(line | {"fields": fields}))
        pathlib.Path(folder, "theirs.jsonl").write_text("\n".join(lines) + "\n")
        subprocess.run(
            ["cargo", "test", "--release", "--quiet", "--lib", "--", "--ignored", "--exact", EXCHANGE],
            cwd=ROOT,
            env=os.environ | {"LEAFBENCH_EXCHANGE": folder},
            check=True,
        )
        ours = [json.loads(line) for line in pathlib.Path(folder, "ours.jsonl").read_text().splitlines()]
    assert ours, "leafbench wrote no frames"
    for line in ours:
        message = database.get_message_by_frame_id(line["id"])
        data = bytes.fromhex(line["hex"])
        fields = message.decode(data, decode_choices=False, scaling=False)
        fields.pop("crc", None)
        assert (message.name, fields) == (line["name"], line["fields"]), line
        assert seal(message.name, data) == data, f"CRC-8 of {line}"
    print(f"cantools {cantools.__version__}: {len(lines)} of its frames are ours, {len(ours)} of ours are its")


if __name__ == "__main__":
    main()
