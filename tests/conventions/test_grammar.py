"""One grammar: `verb(robot, what..., *, scene=None, seed=0, options=None, progress=None, **changes)`."""

import inspect
import re

import public
import pytest

DEFAULTS = {"seed": (0,), "options": (None,), "progress": (None,), "margin": (0.0,), "dt": (0.001, 0.01), "collision": (True,)}
DIALECT = {  # what was said in other words -> the word
    **{"chain": "robot", "arm": "robot", "period": "dt", "timestep": "dt", "file": "path", "filename": "path"},
    **{"q_from": "start", "q_to": "goal", "begin": "start", "aim": "goal", "home": "start", "horizon": "options"},
    **{"lead": "slide", "leading": "slides", "depth": "refine", "cushion": "margin", "trials": "rounds"},
    **{"rate": "qdot", "times": "time", "period_s": "dt", "how": "options"},
}
EXCEPTIONS = {  # at most five, each with its reason
    "analytic.closed_form": "the contract: closed_form(robot, pose, slide), slide where the robot has one",
    "spmd.kernel": "a decorator: the function is left out where options are given",
}
FUNCTIONS = {
    f"{package}.{name}": inspect.unwrap(what)
    for package in public.packages()
    for name, what in public.names(package).items()
    if inspect.isfunction(inspect.unwrap(what))
}
SHOWN = {id(what) for package in public.packages() for what in public.names(package).values()}


def faults(name, function):
    """Yields what is said in another grammar."""
    given = inspect.signature(function).parameters
    for each in given.values():
        optional = each.default is not each.empty
        if optional and each.kind is not each.KEYWORD_ONLY and name not in EXCEPTIONS:
            yield f"{each.name} can be left out, and is not by keyword alone"
        if optional and each.default not in DEFAULTS.get(each.name, (each.default,)):
            yield f"{each.name}={each.default!r}; it is {DEFAULTS[each.name][0]!r} in the library"
        if each.name in DIALECT:
            yield f"{each.name} is {DIALECT[each.name]}"
    if "options" in given and [each.name for each in given.values() if each.kind is each.VAR_KEYWORD] != ["changes"]:
        yield "options without **changes"
    if "robot" in given and next(iter(given)) != "robot" and given["robot"].kind is not inspect.Parameter.KEYWORD_ONLY:
        yield "robot does not stand first"
    for word in set(re.findall(r"\w+", " ".join(str(each) for each in inspect.get_annotations(function).values()))):
        what = function.__globals__.get(word)
        if inspect.isclass(what) and what.__module__.startswith("jaxik.") and id(what) not in SHOWN:
            yield f"{word} is taken or returned, and on no face"


@pytest.mark.parametrize("name", FUNCTIONS)
def test_one_grammar(name):
    assert not list(faults(name, FUNCTIONS[name]))


def test_exceptions_are_few_and_there():
    assert len(EXCEPTIONS) <= 5 and set(EXCEPTIONS) <= set(FUNCTIONS)
