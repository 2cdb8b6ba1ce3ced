"""The C files of an exported folder, which are compiled where it is used: an example, a test by numbers, and CMake's file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from jaxik.codegen.functions import Field, Function
from jaxik.codegen.robot_functions import Sampled

ULP = 4  # units in the last place that other instructions may round otherwise


def cmake_lists(name: str, functions: Sequence[Function]) -> str:
    """The text of `CMakeLists.txt`: an imported library, and, if it is nobody's part, the example and the test."""
    needs = any(each.calls for each in functions)
    return f"""# The library of {name} for CMake. Made by jaxik.
# In another project: add_subdirectory({name}), target_link_libraries(yours {name}).
cmake_minimum_required(VERSION 3.16)
project({name}_exported C)

add_library({name} STATIC IMPORTED GLOBAL)
set_target_properties({name} PROPERTIES
  IMPORTED_LOCATION "${{CMAKE_CURRENT_SOURCE_DIR}}/lib{name}.a"
  INTERFACE_INCLUDE_DIRECTORIES "${{CMAKE_CURRENT_SOURCE_DIR}}"{
        '''
  INTERFACE_LINK_LIBRARIES m'''
        if needs
        else ""
    })

if(CMAKE_SOURCE_DIR STREQUAL CMAKE_CURRENT_SOURCE_DIR)
  enable_testing()
  foreach(program main test)
    add_executable({name}_${{program}} ${{program}}.c)
    target_link_libraries({name}_${{program}} {name})
  endforeach()
  add_test(NAME {name} COMMAND {name}_test)
endif()
"""


def example(name: str, samples: Sequence[Sampled]) -> str:
    """The text of `main.c`: one call of each function, and what it returns."""
    lines = [f"/* One call of each function of {name}. Made by jaxik. */", "#include <stdio.h>", f'#include "{name}.h"', ""]
    lines += [_SHOW.replace("REAL", _real(samples)), "int main(void) {"]
    for each in samples:
        function = each.function
        lines.append("  {")
        for field, values in zip(function.arguments, each.arguments, strict=True):
            first = values if field.shared else values[0]
            lines.append(f"    static const {_array(field, field.name)} = {{{_numbers(_trimmed(field, first), field)}}};")
        lines += [f"    {_array(field, field.name)};" for field in function.results]
        lines += [f"    {each}" for each in _workspace(function)]
        lines.append(f"    {function.name}({_given(function)});")
        lines += [
            f'    show("{function.name}: {f.name}", {f.name}, {f.size}, {_columns(f)});'
            for f in function.results
            if f.kind in _FLOATS
        ]
        lines.append("  }")
    return "\n".join([*lines, "  return 0;", "}", ""])


def test(name: str, samples: Sequence[Sampled]) -> str:
    """The text of `test.c`: samples of each function, one by one and as a batch, beside what jaxik computed at export."""
    kind = _real(samples)
    lines = [f"/* The functions of {name} beside numbers that were computed when they were exported. Made by jaxik. */"]
    lines += [
        "#include <math.h>",
        "#include <stdint.h>",
        "#include <stdio.h>",
        "#include <string.h>",
        f'#include "{name}.h"',
        "",
        _CHECKS.replace("REAL", kind).replace("BITS", {"float": "32", "double": "64"}[kind]),
    ]
    lines += [line for each in samples for line in _data(each)]
    lines += ["int main(void) {"]
    lines += [line for each in samples for line in _checked(each)]
    lines += [
        '  printf(failed ? "%d checks failed\\n" : "all as computed at export\\n", failed);',
        "  return failed != 0;",
        "}",
        "",
    ]
    return "\n".join(lines)


# --------------------------------------------------------------------------------------------------------------------
# Parts

_FLOATS = ("float", "double")
_SHOW = """static void show(const char *what, const REAL *x, int size, int columns) {
  printf("%s =", what);
  for (int i = 0; i < size; i++) printf("%s%10.5f", i % columns ? " " : "\\n  ", (double)x[i]);
  printf("\\n");
}
"""
_CHECKS = f"""static int failed = 0;

/* Units in the last place between two numbers; 0 of two that are equal, the largest of a NaN and a number. */
static uint64_t apart(REAL a, REAL b) {{
  intBITS_t x, y;
  if (a == b || (a != a && b != b)) return 0;
  if (a != a || b != b) return UINT64_MAX;
  memcpy(&x, &a, sizeof x);
  memcpy(&y, &b, sizeof y);
  x = x < 0 ? INTBITS_MIN - x : x;
  y = y < 0 ? INTBITS_MIN - y : y;
  return x > y ? (uint64_t)x - (uint64_t)y : (uint64_t)y - (uint64_t)x;
}}

static void compare(const char *what, const REAL *found, const REAL *wanted, size_t size) {{
  uint64_t most = 0;
  for (size_t i = 0; i < size; i++) {{
    uint64_t here = apart(found[i], wanted[i]);
    most = here > most ? here : most;
  }}
  printf("%-40s %zu numbers, at most %llu ulp apart\\n", what, size, (unsigned long long)most);
  failed += most > {ULP};
}}
"""


def _real(samples: Sequence[Sampled]) -> str:
    """The type of the results that are compared."""
    return "double" if any(f.kind == "double" for each in samples for f in each.function.results) else "float"


def _array(field: Field, name: str, rows: int | None = None) -> str:
    return f"{field.type} {name}[{max(field.size if rows is None else rows, 1)}]"


def _columns(field: Field) -> int:
    return field.shape[-1] if field.shape else 1


def _trimmed(field: Field, values: np.ndarray) -> np.ndarray:
    """A shared table without the rows of zeros at its end: C fills them up."""
    flat = np.ravel(values)
    used = int(np.flatnonzero(flat)[-1]) + 1 if field.shared and flat.any() else len(flat)
    return flat[:used]


def _numbers(values: np.ndarray, field: Field) -> str:
    """Numbers as C has them; floats to the last bit."""
    return ", ".join(map(_number(field), np.ravel(values).tolist()))


def _number(field: Field) -> Any:
    if field.kind not in _FLOATS:
        return lambda x: str(int(x))
    end = "f" if field.kind == "float" else ""
    odd = lambda x: f"({field.type})NAN" if x != x else f"{'-' * (x < 0)}({field.type})INFINITY"
    return lambda x: f"{float(x).hex()}{end}" if np.isfinite(x) else odd(x)


def _given(function: Function) -> str:
    """The arguments of a call."""
    given = [f.name for f in (*function.arguments, *function.results)]
    return ", ".join([*given, "workspace"] if function.workspace else given)


def _workspace(function: Function) -> list[str]:
    return [f"static _Alignas(64) unsigned char workspace[{function.workspace}];"] if function.workspace else []


def _data(sample: Sampled) -> Iterable[str]:
    """Arrays of arguments and of the results that are wanted."""
    function = sample.function
    arrays = zip((*function.arguments, *function.results), (*sample.arguments, *sample.results), strict=True)
    for field, values in arrays:
        head = f"static const {_array(field, f'{function.name}_{field.name}', values.size)}"
        yield f"{head} = {{{_numbers(_trimmed(field, values), field)}}};"
    yield ""


def _checked(sample: Sampled) -> Iterable[str]:
    """Calls, one by one and as a batch."""
    function, rows = sample.function, len(sample.results[0])
    yield "  {"
    for f in function.results:
        yield f"    static {_array(f, f'one_{f.name}', rows * f.size)}, many_{f.name}[{max(rows * f.size, 1)}];"
    yield from (f"    {line}" for line in _workspace(function))
    place = lambda f, one: f" + i * {f.size}" if one and not f.shared else ""
    given = lambda what, one: [
        *(f"{function.name}_{f.name}{place(f, one)}" for f in function.arguments),
        *(f"{what}_{f.name}{place(f, one)}" for f in function.results),
        *(["workspace"] if function.workspace else []),
    ]
    yield f"    for (size_t i = 0; i < {rows}; i++) {function.name}({', '.join(given('one', True))});"
    yield f"    {function.name}_batch({', '.join([str(rows), *given('many', False)])});"
    for f in function.results:
        yield from _compared(function.name, f, rows)
    yield "  }"


def _compared(name: str, field: Field, rows: int) -> Iterable[str]:
    """The results one by one beside those of the batch, and beside those that are wanted."""
    one, wanted = f"one_{field.name}", f"{name}_{field.name}"
    yield f"    if (memcmp({one}, many_{field.name}, sizeof {one}))"
    yield f'      failed++, printf("{name}: one and many differ\\n");'
    if field.kind in _FLOATS:
        yield f'    compare("{name}: {field.name}", {one}, {wanted}, {rows * field.size});'
    else:
        yield f"    if (memcmp({one}, {wanted}, sizeof {one}))"
        yield f'      failed++, printf("{name}: {field.name} differs\\n");'
