"""A static library: object files end to end, with an index of what each defines, as `ar` writes them [System V, GNU]."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple


class Member(NamedTuple):
    """An object file in a library, and the names of the functions that it defines."""

    name: str
    image: bytes
    symbols: Sequence[str]


def archive(members: Sequence[Member]) -> bytes:
    """The library. It bears no time and no user: equal members make an equal library. Names may have any length."""
    longer = "".join(f"{each.name}/\n" for each in members).encode()
    names = [entry.encode() for each in members for entry in each.symbols]
    index = 4 + 4 * len(names) + sum(len(name) + 1 for name in names)
    place, places = len(_MAGIC) + _room(index) + _room(len(longer)), []
    for each in members:
        places += [place] * len(each.symbols)
        place += _room(len(each.image))
    table = struct.pack(f">{1 + len(names)}I", len(names), *places) + b"".join(name + b"\0" for name in names)
    parts = [_MAGIC, _entry("/", table), _entry("//", longer)]
    at = 0
    for each in members:
        parts.append(_entry(f"/{at}", each.image))
        at += len(each.name.encode()) + 2
    return b"".join(parts)


_MAGIC, _HEADER = b"!<arch>\n", 60


def _room(size: int) -> int:
    """The bytes of an entry with its header; it ends at an even place."""
    return _HEADER + size + size % 2


def _entry(name: str, content: bytes) -> bytes:
    header = f"{name:<16}{0:<12}{0:<6}{0:<6}{644:<8}{len(content):<10}`\n".encode()
    return header + content + b"\n" * (len(content) % 2)
