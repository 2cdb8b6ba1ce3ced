"""Rows of a batch as columns of vectors: read and written as they lie in memory, and transposed in registers.

A few columns at a time: the same entries of `width` rows are as many short loads, joined to whole vectors, whose square blocks
are then transposed.
"""

from __future__ import annotations

from collections.abc import Sequence

from jaxik.spmd.text import BYTES, Text


def together(size: int, width: int) -> int:
    """How many columns of a row of `size` are transposed together: 1, 2 or 4, and no more than there are lanes."""
    return {1: 1, 2: 2, 3: 2}.get(min(size, width), 4)


def starts(size: int, width: int) -> list[int]:
    """Where such blocks of columns start; the last may repeat a few of the one before."""
    count = together(size, width)
    return sorted({min(s, size - count) for s in range(0, size, count)}) if size else []


def read(t: Text, base: str, size: int, first: int, kind: str) -> list[str]:
    """A block of columns, from `first` on, of rows of `size` at `base`."""
    n, count = t.width, together(size, t.width)
    if size == 1:
        return [t.assign(f"load <{n} x {kind}>, ptr {base}, align {BYTES[kind]}")]
    rows = []
    for lane in range(n):
        place = t.assign(f"getelementptr {kind}, ptr {base}, i64 {lane * size + first}")
        rows.append(t.assign(f"load <{count} x {kind}>, ptr {place}, align {BYTES[kind]}"))
    return _transposed(t, [_joined(t, rows[j::count], count, kind) for j in range(count)], kind)


def write(t: Text, base: str, size: int, first: int, columns: Sequence[str], kind: str) -> None:
    """A block of columns, from `first` on, into rows of `size` at `base`."""
    n, count = t.width, len(columns)
    if size == 1:
        t.line(f"store <{n} x {kind}> {columns[0]}, ptr {base}, align {BYTES[kind]}")
        return
    for j, joined in enumerate(_transposed(t, columns, kind)):
        for g in range(n // count):
            part = range(g * count, (g + 1) * count)
            row = t.shuffle(joined, "poison", n, kind, part) if n > count else joined
            place = t.assign(f"getelementptr {kind}, ptr {base}, i64 {(g * count + j) * size + first}")
            t.line(f"store <{count} x {kind}> {row}, ptr {place}, align {BYTES[kind]}")


def _joined(t: Text, parts: list[str], size: int, kind: str) -> str:
    """Vectors of `size` side by side."""
    while len(parts) > 1:
        pairs = zip(parts[::2], parts[1::2], strict=True)
        parts = [t.shuffle(a, b, size, kind, range(2 * size)) for a, b in pairs]
        size *= 2
    return parts[0]


def _transposed(t: Text, v: Sequence[str], kind: str) -> list[str]:
    """Two or four vectors, each square block of them transposed: from joined rows to columns, or back."""
    n, count = t.width, len(v)

    def pick(a: str, b: str, pattern: Sequence[int]) -> str:
        """Picks the entries of that pattern in each block, of a and then of b."""
        places = [[g + k if k < count else n + g + k - count for k in pattern] for g in range(0, n, count)]
        return t.shuffle(a, b, n, kind, [x for block in places for x in block])

    if count == 2:
        return [pick(v[0], v[1], (0, 2)), pick(v[0], v[1], (1, 3))]
    a, b = pick(v[0], v[1], (0, 4, 1, 5)), pick(v[0], v[1], (2, 6, 3, 7))
    c, d = pick(v[2], v[3], (0, 4, 1, 5)), pick(v[2], v[3], (2, 6, 3, 7))
    low, high = (0, 1, 4, 5), (2, 3, 6, 7)
    return [pick(a, c, low), pick(a, c, high), pick(b, d, low), pick(b, d, high)]
