"""The header of exported functions, for C and C++: shapes, units, what is needed beside it."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from jaxik.codegen.functions import Field, Function
from jaxik.codegen.targets import WORDS
from jaxik.version import __version__

WIDTH = 100
LICENCE = (
    "The licence of this file, and of the machine code beside it, is yours to choose: jaxik claims no right in what it makes."
)


def header(name: str, functions: Sequence[Function], words: str = "") -> str:
    """The text of `NAME.h`."""
    guard = f"{name.upper()}_H"
    lines = [
        comment(
            [
                *([words] if words else []),
                f"Made by jaxik {__version__} for {_target(functions)}.",
                LICENCE,
                _contract(functions),
            ]
        )
    ]
    lines += [f"#ifndef {guard}", f"#define {guard}", "", "#include <stddef.h>", "#include <stdint.h>", ""]
    lines += ["#ifdef __cplusplus", 'extern "C" {', "#endif", ""]
    for function in functions:
        lines += _declared(function)
    lines += ["#ifdef __cplusplus", "}", "#endif", "", f"#endif /* {guard} */", ""]
    return "\n".join(lines)


def _target(functions: Sequence[Function]) -> str:
    name = functions[0].target
    return f"{name}: {WORDS[name]}"


def _contract(functions: Sequence[Function]) -> str:
    """The contract that all functions keep."""
    calls = sorted({call for function in functions for call in function.calls})
    needs = (
        f"They ask the C library for {', '.join(calls)} (link with -lm), and for nothing else."
        if calls
        else "They call no other code."
    )
    return (
        "Arrays lie row by row, the last index next to each other, and results must not overlap arguments. NAME takes one "
        "configuration; NAME_batch takes count of them, one after the other, with the same bits. They allocate nothing, "
        "keep nothing from call to call, and may be called by many threads at once. Numbers below the normal range count as 0 "
        "inside; the processor's state is restored, which costs some 10 ns that a thread saves that has set it so itself "
        f"(_MM_SET_FLUSH_ZERO_MODE and _MM_SET_DENORMALS_ZERO_MODE on x86-64). {needs}"
    )


def _declared(function: Function) -> list[str]:
    """The declarations of both functions, below what they do."""
    told = [f"{function.name}: {function.words}"] if function.words else [f"{function.name}"]
    told += [_told(f, "in") for f in function.arguments] + [_told(f, "out") for f in function.results]
    lines = [comment(told)]
    if function.workspace:
        macro = f"{function.name.upper()}_WORKSPACE"
        lines += [
            comment([f"workspace: {macro} bytes, aligned to 64, of which each thread has its own."]),
            f"#define {macro} {function.workspace}",
        ]
    taken = [f"const {f.type} *{f.name}" for f in function.arguments] + [f"{f.type} *{f.name}" for f in function.results]
    taken += ["void *workspace"] if function.workspace else []
    lines += [_wrapped(f"void {function.name}(", taken), _wrapped(f"void {function.name}_batch(", ["size_t count", *taken]), ""]
    return lines


def _told(field: Field, way: str) -> str:
    shape = "".join(f"[{n}]" for n in field.shape) or "one number"
    once = "; one for the whole batch" if field.shared else ""
    return f"  {way} {field.name}: {shape}{f', {field.words}' if field.words else ''}{once}"


def _wrapped(begin: str, parts: Sequence[str]) -> str:
    """A declaration, a line an argument where it is long."""
    line = f"{begin}{', '.join(parts)});"
    return line if len(line) <= WIDTH else f"{begin}\n    " + ",\n    ".join(parts) + ");"


def comment(paragraphs: Sequence[str]) -> str:
    """A comment, a paragraph a line or more."""
    fill = lambda text: textwrap.wrap(
        text,
        WIDTH - 3,
        initial_indent=" " * (len(text) - len(text.lstrip())),
        subsequent_indent="    " if text.startswith(" ") else "",
    )
    lines = [line for each in paragraphs for line in fill(each.strip() if not each.startswith(" ") else each)]
    lines = [line.replace("*/", "* /").replace("/*", "/ *") for line in lines]  # of a comment, in words that a user wrote
    return "\n".join(["/*", *(f" * {line}".rstrip() for line in lines), " */"])
