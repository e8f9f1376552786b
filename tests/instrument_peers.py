"""What tests of the instruments need of the other end: their files by name, and frames as the devices write them."""

import struct

from configs import read_source
from rig.bench.instrument import FOLDER, instrument_of
from rig.instruments import lutron
from rig.instruments.codecs import edge_frames


def read_instrument(name):
    """The settings in a shipped instrument file."""
    path = FOLDER / f"{name}.toml"
    return instrument_of(read_source(path), str(path))


def lutron_bytes(frame, decimals):
    """A frame of a Lutron meter."""
    digits = round(abs(frame.value) * 10**decimals)
    text = f"4{frame.display}{frame.unit_code}{int(frame.value < 0.0)}{decimals}{digits:08d}"
    return bytes([lutron.FIRST_BYTE]) + text.encode("ascii") + bytes([lutron.LAST_BYTE])


def edge_bytes(frame):
    """A frame of the edge counter."""
    head = (edge_frames.SYNC, frame.kind, frame.sequence, frame.flags, frame.ticks, frame.edges)
    body = struct.pack("<BBBBIB", *head)
    return body + bytes([edge_frames.crc8(body)])
