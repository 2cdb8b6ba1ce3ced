"""Refusals of what cannot be exported: one line, with the operation, its place and the mend."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxik
from jaxik.codegen import export_robot
from jaxik.spmd import machine

pytestmark = pytest.mark.kernels(reason="machine code is made by llvmlite")


def calls_back(x):
    return jax.pure_callback(np.sin, jax.ShapeDtypeStruct((), np.float32), x)


def prints(x):
    jax.debug.print("{}", x)
    return x


def picks(x):
    return jnp.sum(x[x > 0])


def branches(x):
    return x if x > 0 else -x


def draws(x):
    return x + jax.random.normal(jax.random.key(0))


def takes_a_key(x):
    return x


def splits(x):
    return jnp.linalg.svd(jnp.outer(x, x))[1]


def two(x, y):
    return x + y


CASES = {
    "a host callback": (
        calls_back,
        (0.0,),
        {},
        r"calls_back: .*'pure_callback' \(test_export_refusals.py, line \d+\); compute it",
    ),
    "a print": (prints, (0.0,), {}, r"prints: .*'debug_print' \(test_export_refusals.py, line \d+\)|prints: .*callback"),
    "a dynamic shape": (
        picks,
        (np.zeros(3),),
        {},
        r"picks: .* shape .*\(test_export_refusals.py, line \d+\); write arrays of fixed",
    ),
    "a branch": (branches, (0.0,), {}, r"branches: .* branch that depends on values \(test_export_refusals.py, line \d+\)"),
    "a random number": (draws, (0.0,), {}, r"draws: .*'random_\w+' \(test_export_refusals.py, line \d+\); draw random numbers"),
    "a key": (takes_a_key, (jax.eval_shape(jax.random.key, 0),), {}, r"takes_a_key: a random key is no number of C; draw"),
    "no kernel": (
        splits,
        (np.zeros(3),),
        {},
        r"splits: a kernel cannot do the primitive 'svd' \(test_export_refusals.py, line \d+\)",
    ),
    "too few": (two, (0.0,), {}, "two: does not take such a signature: missing a required argument: 'y'"),
    "shapes": (
        two,
        (np.zeros(3), np.zeros(2)),
        {},
        r"two: does not take such a signature \(test_export_refusals.py, line \d+\): ",
    ),
    "no tuple": (two, 0.0, {}, "two: signature is a float; write a tuple"),
    "objects": (two, ("a", "b"), {}, "two: an argument of type"),
    "complex": (two, (1j, 1j), {}, "two: an argument of type complex128"),
    "a target": (two, (0.0, 0.0), {"target": "z80"}, "target 'z80' is not known; choose one of native, x86-64, "),
    "a name": (two, (0.0, 0.0), {"name": "2nd"}, "'2nd' is no name that C has free"),
    "a word of C": (two, (0.0, 0.0), {"name": "double"}, "'double' is no name that C has free"),
    "a word of C++": (lambda export: export, (0.0,), {"name": "same"}, "'export' is no name that C has free"),
    "a word that C reserves": (two, (0.0, 0.0), {"name": "_Two"}, "'_Two' is no name that C has free"),
    "a function of C": (two, (0.0, 0.0), {"name": "printf"}, "'printf' is taken by C's library; choose another by name="),
    "mathematics": (two, (0.0, 0.0), {"name": "sinf"}, "'sinf' is taken by C's library; .* such as robot_sinf"),
    "C's library": (two, (0.0, 0.0), {"name": "m"}, "'m' is taken by C's library"),
    "CMake's": (two, (0.0, 0.0), {"name": "test"}, "'test' is taken by CMake; choose another by name=, such as robot_test"),
    "a word of Python": (
        two,
        (0.0, 0.0),
        {"name": "lambda", "python": True},
        "'lambda' is a word of Python's; ",
    ),
    "a function of Python": (two, (0.0, 0.0), {"name": "zip", "python": True}, "'zip' is a word of Python's; "),
    "a module": (two, (0.0, 0.0), {"name": "numpy", "python": True}, "numpy.py would hide the module numpy; .* robot_numpy"),
    "words": (two, (0.0, 0.0), {"words": {"typo": "[m]"}}, "two: words tell of 'typo', .*; choose of two, x, y, result"),
    "results": (two, (0.0, 0.0), {"results": ["a", "b"]}, "two: results names 2, and the function has 1"),
    "twice": (two, (0.0, 0.0), {"results": ["x"]}, "two: two arguments or results are called 'x'"),
    "shared": (two, (0.0, 0.0), {"shared": ["z"]}, "two: shared 'z' is no argument; choose of x, y"),
    "elsewhere": (
        two,
        (0.0, 0.0),
        {"target": "aarch64", "python": True},
        "a shared library for aarch64 is linked on the machine",
    ),
}


@pytest.mark.usefixtures("untyped")
@pytest.mark.parametrize("case", CASES)
def test_refused_in_one_line(case, tmp_path):
    function, signature, more, told = CASES[case]
    with pytest.raises(ValueError, match=told) as raised:
        jaxik.export(function, signature, tmp_path, **more)
    assert "\n" not in str(raised.value) and str(raised.value).startswith("export: ")
    assert not any(tmp_path.iterdir())


def test_without_a_compiler(tmp_path, monkeypatch):
    monkeypatch.setattr(machine, "llvm", lambda: None)
    with pytest.raises(ValueError, match="export: machine code is made by llvmlite, which is not installed; pip install"):
        jaxik.export(two, (0.0, 0.0), tmp_path)


def test_a_robot_lacks_what_a_function_needs(tmp_path):
    with pytest.raises(ValueError, match="panda has no bodies"):
        export_robot(jaxik.load("panda"), ["inverse_dynamics"], tmp_path)
    with pytest.raises(ValueError, match="a function 'poses' is not known; choose of pose, jacobian"):
        export_robot(jaxik.load("panda"), ["poses"], tmp_path)


@pytest.mark.parametrize(
    ("name", "library"),
    [("2dof planar", "robot_2dof_planar"), ("double", "robot_double"), ("臂", "robot")],
)
def test_a_robot_whose_name_c_has_not_free(name, library, tmp_path):
    robot = dataclasses.replace(jaxik.load("planar2"), name=name)
    assert export_robot(robot, ["pose"], tmp_path).name == library
    assert (tmp_path / f"lib{library}.a").exists()


def test_a_path_that_is_a_file(tmp_path):
    file = tmp_path / "taken"
    file.write_text("mine")
    for path in (file, file / "inside"):
        with pytest.raises(ValueError, match=r"two: .*taken is a file; give the path of a folder"):
            jaxik.export(two, (0.0, 0.0), path)
    with pytest.raises(ValueError, match=r"panda: .*taken is a file"):
        export_robot(jaxik.load("panda"), ["pose"], file)
    assert file.read_text() == "mine"


def test_arguments_may_be_called_like_functions(tmp_path):
    made = jaxik.export(lambda time, y0: time * y0, (0.0, 0.0), tmp_path, name="moved")
    assert "const float *time" in (tmp_path / "moved.h").read_text() and made.name == "moved"
