"""One kernel again and again, on arrays of the same shapes: what a loop of a kilohertz calls.

The time of such a call is Python's own, so there is little of it: the arrays that the kernel reads and writes lie in a `Block`
whose addresses it knows already, and a function is written for these numbers of arguments and results, as `dataclasses` write
an `__init__`: a loop over them would take twice the time. Whoever calls takes a block from a list and puts it back, each of
which is one step of the interpreter, so that threads need no lock; who finds none makes one.
"""

from __future__ import annotations

import array
import ctypes
import functools
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxik.spmd.threads import CHUNK, FIRST, INNER, TOTAL, VECTORS

ALIGNED = 64  # bytes, a line of the cache
# a kernel takes vectors of lanes from the word NEXT, so many at a time, until it finds none: two turns that leave it at 0 again
ROUND = -(2**63)
# [s] below which a kernel keeps the interpreter's lock: who lets go of it waits for a thread that computes, up to 5 ms
SHORT = 20e-6
HOLDING = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)  # once: `ctypes` makes another type, which is garbage later, at each turn


class Row(NamedTuple):
    """The shape and type of an argument or result, which is an array of one row for the kernel."""

    shape: tuple[int, ...]
    dtype: np.dtype

    @property
    def numbers(self) -> str:
        """The name of Python's type of such numbers, if it is one number; else nothing."""
        return {"f": "float", "i": "int", "u": "int", "b": "bool"}[self.dtype.kind] if self.shape == () else ""


def address(x: np.ndarray) -> int:
    """Where an array lies; a third of the time of `x.ctypes.data`, of which a call asks a dozen."""
    try:
        return ctypes.addressof(ctypes.c_char.from_buffer(x))  # type: ignore[arg-type]
    except (TypeError, ValueError):  # read-only, or without entries
        return int(x.ctypes.data)


def words(operands: Sequence[np.ndarray], outs: Sequence[np.ndarray], count: int, vectors: int, chunk: int) -> array.array[int]:
    """The words of a call that the kernel reads: `count` rows, which are so many `vectors` of lanes, `chunk` of them a turn."""
    found = array.array("q", bytes(8 * FIRST))
    found[TOTAL], found[INNER], found[VECTORS], found[CHUNK] = vectors, count, vectors, chunk
    for x in operands:
        found.extend((address(x), 0))
    found.extend(map(address, outs))
    return found


class Repeated:
    """A kernel for arrays like those of the `example`, which gives such `results`, `bound` to what it shares.

    A bound function `again(*arrays, out=None)` returns new arrays, or those of `out`, into which the results are written. They
    come in a `form`: `list`, `tuple`, a `NamedTuple` of as many, or None for the only one itself. It raises `TypeError` for
    other numbers of arguments and, `checked`, `TypeError` or `AttributeError` for other shapes or types.
    """

    def __init__(
        self,
        work: Any,
        example: Sequence[np.ndarray],
        results: Sequence[Row],
        *,
        count: int = 1,
        vectors: int = 1,
        checked: bool = False,
        form: Any = list,
    ):
        self._work, self._example, self._numbers = work, [np.array(x) for x in example], (count, vectors, ROUND)
        self._rows, self._results = [Row(x.shape, x.dtype) for x in example], list(results)
        brackets = {None: ("", ""), list: ("[", "]"), tuple: ("(", ")")}.get(form, ("form(", ")"))
        known: dict[str, Any] = {"form": form}
        for k, row in enumerate((*self._rows, *results)):
            known |= {f"shape{k}": row.shape, f"dtype{k}": row.dtype}
        exec(_code(tuple(row.numbers for row in self._rows), checked, len(results), *brackets), known)
        self._made = known.pop("made")  # which would hold itself by its names
        self._call: Any = None
        self._free: list[Any] = []  # the blocks of what was bound last

    def bound(self, shared: Sequence[np.ndarray]) -> Callable[..., Any]:
        """The function that reads `shared` behind the arrays, where they lie."""
        rows, free = self._rows, []  # type: list[Row], list[Any]

        def block() -> tuple[Any, ...]:
            arrays = _laid_out([*rows, *self._results])
            asked = words([*arrays[: len(rows)], *shared], arrays[len(rows) :], *self._numbers)
            return (asked.buffer_info()[0], (asked, shared), *arrays)

        free.append(self._spare(shared) or block())
        if self._call is None:
            for x, given in zip(free[0][2:], self._example, strict=False):
                x[...] = given
            self._call = _held(self._work, free[0][0])
        self._free = free
        return self._made(free.pop, free.append, block, self._call)  # type: ignore[no-any-return]

    def _spare(self, shared: Sequence[np.ndarray]) -> tuple[Any, ...] | None:
        """A block of what was bound last, if it has one that nobody uses, with the addresses of what is shared now."""
        try:
            address_of_words, (asked, before), *arrays = self._free.pop()
        except IndexError:
            return None
        first = FIRST + 2 * len(self._rows)
        for k, (x, old) in enumerate(zip(shared, before, strict=True)):
            if x is not old:
                asked[first + 2 * k] = address(x)
        return (address_of_words, (asked, shared), *arrays)


def _held(work: Any, asked: int) -> Any:
    """The call of a kernel that suits it, by the quickest of a few: with the interpreter's lock held, or let go of."""
    times = []
    for _ in range(3):
        begin = time.perf_counter()
        work(asked)
        times.append(time.perf_counter() - begin)
    long = min(times) > SHORT
    place: Any = ctypes.cast(work, ctypes.c_void_p).value
    return work if long else HOLDING(place)


def _laid_out(rows: Sequence[Row]) -> list[np.ndarray]:
    """Arrays of zeros, one behind the other in one piece of memory, each from a line of the cache on."""
    sizes = [-(-row.dtype.itemsize * math.prod(row.shape) // ALIGNED) * ALIGNED for row in rows]
    memory = np.zeros(sum(sizes) + ALIGNED, np.uint8)
    place, arrays = -address(memory) % ALIGNED, []
    for row, size in zip(rows, sizes, strict=True):
        arrays.append(np.ndarray(row.shape, row.dtype, memory, place))  # type: ignore[arg-type]
        place += size
    return arrays


@functools.lru_cache(maxsize=256)
def _code(numbers: tuple[str, ...], checked: bool, results: int, before: str, after: str) -> Any:
    """The maker of the function of arguments that are arrays, or `numbers` of one of Python's types, and so many results, with
    brackets `before` and `after` them; of an array, a number, and one result in a list:

    def made(pop, push, block, work):
        def again(a0, a1, *, out=None):
            if a0.shape != shape0 or a0.dtype is not dtype0:
                raise TypeError
            if type(a1) is not float and (a1.shape != shape1 or a1.dtype is not dtype1):
                raise TypeError
            if out is not None:
                [z0, ] = out
                if z0.shape != shape2 or z0.dtype is not dtype2:
                    raise TypeError
            try:
                taken = pop()
            except IndexError:
                taken = block()
            address, held, x0, x1, y0 = taken
            x0[...] = a0
            x1[...] = a1
            work(address)
            if out is None:
                out = [y0.copy(), ]
            else:
                z0[...] = y0
            push(taken)
            return out
        return again
    """
    inside, outside = range(len(numbers)), range(results)
    names = lambda word, numbers: "".join(f"{word.format(k)}, " for k in numbers)
    is_other = lambda x, k: f"{x}.shape != shape{k} or {x}.dtype is not dtype{k}"
    other = [is_other(f"a{k}", k) for k in inside]
    wrong = [f"type(a{k}) is not {numbers[k]} and ({each})" if numbers[k] else each for k, each in enumerate(other)]
    lines = [
        f"def again({names('a{}', inside)}*, out=None):",
        *(f" if {each}:\n  raise TypeError" for each in wrong if checked),
        " if out is not None:",
        f"  {'[' + names('z{}', outside) + ']' if before else 'z0'} = out",
        *(f"  if {is_other(f'z{k}', len(numbers) + k)}:\n   raise TypeError" for k in outside if checked),
        " try:",
        "  taken = pop()",
        " except IndexError:",
        "  taken = block()",
        f" address, held, {names('x{}', inside)}{names('y{}', outside)}= taken",
        *(f" x{k}[...] = a{k}" for k in inside),
        " work(address)",
        " if out is None:",
        f"  out = {before}{names('y{}.copy()', outside) if before else 'y0.copy()'}{after}",
        " else:",
        *(f"  z{k}[...] = y{k}" for k in outside),
        " push(taken)",
        " return out",
    ]
    inner = "\n".join(lines).replace("\n", "\n ")
    return compile(f"def made(pop, push, block, work):\n {inner}\n return again", "<a repeated call>", "exec")
