"""Stamps in the headers of messages, also of serialized messages, which are not parsed."""

from __future__ import annotations

import struct

from hoid_bags.storage.bag_types import Message, ensure_type, new_message, shared_typestore
from hoid_common.errors import InputError, MessageError
from hoid_common.values import NS_PER_S

_HEADER_FIELD = ('header', 'std_msgs/msg/Header')
_CDR_HEADER_BYTES = 4  # the second of these bytes gives the byte order
_LITTLE, _BIG = struct.Struct('<iI'), struct.Struct('>iI')  # seconds, nanoseconds


def header(stamp_ns: int, frame_id: str) -> Message:
    """Return a std_msgs/Header with a stamp (ns) and the name of a frame."""
    sec, nanosec = divmod(stamp_ns, NS_PER_S)
    stamp = new_message('builtin_interfaces/msg/Time', sec=sec, nanosec=nanosec)
    return new_message('std_msgs/msg/Header', stamp=stamp, frame_id=frame_id)


def begins_with_header(type_name: str) -> bool:
    """Return whether messages of a type begin with a field `header`; False for an unknown type."""
    try:
        ensure_type(type_name)
    except InputError:
        return False
    fields = shared_typestore().fielddefs[type_name][1]
    return bool(fields) and (fields[0][0], fields[0][1][1]) == _HEADER_FIELD


def header_stamp_ns(data: bytes) -> int:
    """Return the stamp (ns) of CDR bytes that begin with a header; MessageError if too short."""
    if len(data) < _CDR_HEADER_BYTES + _LITTLE.size:
        raise MessageError(f'a message of {len(data)} bytes has no header')
    sec, nanosec = _byte_order(data).unpack_from(data, _CDR_HEADER_BYTES)
    return int(sec) * NS_PER_S + int(nanosec)


def shift_header_stamp(data: bytes, offset_ns: int) -> bytes:
    """Return a copy of CDR bytes that begin with a header, with a shifted stamp."""
    shifted = bytearray(data)
    stamp = divmod(header_stamp_ns(data) + offset_ns, NS_PER_S)
    _byte_order(data).pack_into(shifted, _CDR_HEADER_BYTES, *stamp)
    return bytes(shifted)


def _byte_order(data: bytes) -> struct.Struct:
    return _LITTLE if data[1] else _BIG
