"""Exported functions of a Panda, called from C one configuration at a time, beside CasADi's C and Pinocchio's C++.

`python batch_eval/export_benchmark.py` needs `pip install -e ".[test,peers]"`, gcc, and for Pinocchio g++ with Eigen's headers.
One process, one thread; contenders take turns, 64 of 1,024 configurations each, and each contender's median is told. Behind
the other contenders the first call of a turn takes twice as long as the rest: it is told apart, with a reading of the clock in
it, and fifteen more follow before time is taken. Everyone has the same numbers of the same robot, and is held against Pinocchio
in Python. Prints and writes `batch_eval/export_benchmark.json`; `--only jaxik` leaves the peers out, which takes a minute.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import casadi
import jax
import numpy as np
import pinocchio as pin
from peers import casadi_panda
from peers.panda import TIP, urdf_file
from race import machine

import jaxik
from jaxik.codegen import export_robot
from jaxik.collision import clearance

ROWS, TURN, WARM, SPHERES, JUDGED = 1024, 64, 16, 150, 16  # configurations in all, in a turn, before it; spheres; judged
GCC = ("gcc", "-O2")
LIMITS = (  # with which the wheel of Pinocchio was built
    "-DBOOST_MPL_LIMIT_LIST_SIZE=30",
    "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30",
    "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS",
    "-DBOOST_FUSION_INVOKE_MAX_ARITY=12",
)
BEST = ("-O3", "-march=native")  # what a generator's users are told to compile with
ARGUMENTS = {"pose_and_jacobian": ["q"], "inverse_dynamics": ["q", "qdot", "qddot"], "clearance_to_spheres": ["q", "spheres"]}
RESULTS = {"pose_and_jacobian": [16, 42], "inverse_dynamics": [7], "clearance_to_spheres": [1], "ik": [7]}


class Contender(NamedTuple):
    """Who computes what, in `kind` float or double: the C statement of one call at `i`, what declares it, and its objects."""

    who: str
    work: str
    kind: str
    call: str
    declared: str
    objects: list[str]
    size: int


def statement(name: str, kind: str, work: str, count: bool = False) -> str:
    """A call of a function of plain pointers."""
    short = kind[0]
    given = [f"{short}_spheres" if each == "spheres" else f"{short}_{each} + 7 * i" for each in ARGUMENTS[work]]
    given += ["&sphere_count"] if count else []
    outs = [f"{short}_out + {sum(RESULTS[work][:k])}" for k in range(len(RESULTS[work]))]
    return f"{name}({', '.join([*given, *outs])});"


def ours(robots: dict[str, jaxik.Robot], folder: Path) -> list[Contender]:
    """The exported functions, in float and double."""
    found = []
    for kind in ("float", "double"):
        for work, robot in robots.items():
            if work == "ik" and kind == "float":
                continue  # it is computed in float64 alone
            name = f"{kind}_{work}"
            made = export_robot(robot, [work], folder / name, name=name, double=kind == "double")
            call = f"{name}_ik(d_pose + 16 * i, d_out, reason, d_out + 7, d_out + 8, d_out + 9, reason + 1);"
            if work != "ik":
                call = statement(f"{name}_{work}", kind, work, work == "clearance_to_spheres")
            (size,) = made.sizes.values()
            found.append(Contender("jaxik", work, kind, call, f'#include "{name}/{name}.h"', [f"{name}/lib{name}.a"], size))
    return found


def casadis(functions: dict[str, casadi.Function], folder: Path) -> list[Contender]:
    """CasADi's generated C, compiled for this processor."""
    found = []
    for kind in ("float", "double"):
        for work, function in functions.items():
            name = f"casadi_{kind}_{work}"
            code = casadi.CodeGenerator(f"{name}.c", {"casadi_real": kind, "with_header": False})
            code.add(function)
            code.generate(f"{folder}/")
            text = (folder / f"{name}.c").read_text().replace(f"{function.name()}(", f"{name}(")
            (folder / f"{name}.c").write_text(text)
            for level, flags in (("-O2", ("-O2",)), (" ".join(BEST), BEST)):
                made = f"{name}{len(flags)}"
                renamed = f"-D{name}={made}"
                subprocess.run(["gcc", *flags, renamed, "-c", f"{name}.c", "-o", f"{made}.o"], cwd=folder, check=True)
                subprocess.run(["objcopy", f"--keep-global-symbol={made}", f"{made}.o"], cwd=folder, check=True)
                words = [int(function.sz_w()), int(function.sz_iw()), int(function.sz_arg()), int(function.sz_res())]
                declared = f"int {made}(const {kind} **, {kind} **, long long *, {kind} *, int);\n" + wrapper(
                    made, kind, work, words
                )
                size = (folder / f"{made}.o").stat().st_size
                call = statement(f"call_{made}", kind, work)
                found.append(Contender(f"CasADi, gcc {level}", work, kind, call, declared, [f"{made}.o"], size))
    return found


def wrapper(name: str, kind: str, work: str, words: list[int]) -> str:
    """CasADi's call as one of plain pointers."""
    inputs, outputs = len(ARGUMENTS[work]), len(RESULTS[work])
    taken = [f"const {kind} *a{k}" for k in range(inputs)] + [f"{kind} *r{k}" for k in range(outputs)]
    w, iw, arg, res = words
    listed = lambda letter, count: ", ".join(f"{letter}{k}" for k in range(count))
    return f"""static void call_{name}({", ".join(taken)}) {{
  const {kind} *arg[{arg + 1}] = {{{listed("a", inputs)}}};
  {kind} *res[{res + 1}] = {{{listed("r", outputs)}}}, w[{w + 1}];
  long long iw[{iw + 1}];
  {name}(arg, res, iw, w, 0);
}}"""


def pinocchios(model: Any, frame: Any, folder: Path) -> list[Contender]:
    """Pinocchio's C++, compiled from its wheel's headers; nothing where these, or Eigen's, are not there."""
    prefix = Path(pin.__file__).parents[4]
    numbers = lambda x: ", ".join(map(repr, np.ravel(x).tolist()))
    rows = [
        [*model.jointPlacements[i + 1].homogeneous.ravel(), body.mass, *body.lever, *body.inertia.ravel()]
        for i, body in enumerate(list(model.inertias)[1:])
    ]
    text = PINOCCHIO.replace("ROWS", numbers(rows)).replace("TIP", numbers(frame.placement.homogeneous))
    (folder / "peer.cpp").write_text(text)
    command = [
        "g++",
        "-O3",
        "-DNDEBUG",
        "-std=c++17",
        *LIMITS,
        f"-I{prefix / 'include'}",
        "-I/usr/include/eigen3",
        "-c",
        "peer.cpp",
    ]
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if ran.returncode:
        print("without Pinocchio's C++:", next((x for x in ran.stderr.splitlines() if "error" in x), ""))
        return []
    library = ["peer.o", f"-L{prefix / 'lib'}", "-lpinocchio_default", "-lstdc++", f"-Wl,-rpath,{prefix / 'lib'}"]
    library.append(f"-Wl,-rpath-link,{prefix / 'lib'}")
    pair = {
        "pose_and_jacobian": "void pin_pose(const double *, double *, double *);",
        "inverse_dynamics": "void pin_torque(const double *, const double *, const double *, double *);",
    }
    call = {"pose_and_jacobian": "pin_pose", "inverse_dynamics": "pin_torque"}
    who = f"Pinocchio {pin.__version__}, g++ -O3"
    return [Contender(who, w, "double", statement(call[w], "double", w), declared, library, 0) for w, declared in pair.items()]


PINOCCHIO = """
#include <pinocchio/multibody.hpp>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/rnea.hpp>
using namespace pinocchio;
using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
static const double rows[7][29] = {ROWS};
static const double tip[16] = {TIP};
static SE3 placed(const double *x) {
  Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>> T(x);
  return SE3(Eigen::Matrix3d(T.topLeftCorner<3, 3>()), Eigen::Vector3d(T.topRightCorner<3, 1>()));
}
static Model made() {
  Model model;
  for (int i = 0; i < 7; i++) {
    const double *x = rows[i];
    JointIndex at = model.addJoint(i, JointModelRZ(), placed(x), "joint" + std::to_string(i));
    Eigen::Map<const Eigen::Matrix3d> inertia(x + 20);
    model.appendBodyToJoint(at, Inertia(x[16], Eigen::Vector3d(x[17], x[18], x[19]), inertia), SE3::Identity());
  }
  model.addFrame(Frame("tip", 7, 0, placed(tip), OP_FRAME));
  model.gravity.linear() = Eigen::Vector3d(0, 0, -9.81);
  return model;
}
static Model model = made();
static Data data(model);
static const FrameIndex frame = model.getFrameId("tip");
extern "C" void pin_pose(const double *q, double *pose, double *jacobian) {
  static Eigen::Matrix<double, 6, Eigen::Dynamic> J = Eigen::Matrix<double, 6, Eigen::Dynamic>::Zero(6, 7);
  computeFrameJacobian(model, data, Eigen::Map<const Eigen::VectorXd>(q, 7), frame, LOCAL_WORLD_ALIGNED, J);
  Eigen::Map<Rows>(pose, 4, 4) = data.oMf[frame].toHomogeneousMatrix();
  Eigen::Map<Rows>(jacobian, 6, 7) = J;
}
extern "C" void pin_torque(const double *q, const double *v, const double *a, double *torque) {
  using In = Eigen::Map<const Eigen::VectorXd>;
  Eigen::Map<Eigen::VectorXd>(torque, 7) = rnea(model, data, In(q, 7), In(v, 7), In(a, 7));
}
"""

HARNESS = """
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <stdint.h>
#if defined(__x86_64__)
#include <pmmintrin.h>
#include <xmmintrin.h>
#define FLUSH(on) (_MM_SET_FLUSH_ZERO_MODE(on ? _MM_FLUSH_ZERO_ON : _MM_FLUSH_ZERO_OFF), \\
                   _MM_SET_DENORMALS_ZERO_MODE(on ? _MM_DENORMALS_ZERO_ON : _MM_DENORMALS_ZERO_OFF))
#else
#define FLUSH(on) (void)0
#endif
@DECLARED@
static int32_t reason[2];
static double d_pose[16 * @ROWS@], d_q[7 * @ROWS@], d_qdot[7 * @ROWS@], d_qddot[7 * @ROWS@], d_spheres[4 * 4096], d_out[64];
static float f_pose[16 * @ROWS@], f_q[7 * @ROWS@], f_qdot[7 * @ROWS@], f_qddot[7 * @ROWS@], f_spheres[4 * 4096], f_out[64];
static const int32_t sphere_count = @SPHERES@;
@CALLS@
static void (*const calls[])(long) = {@NAMES@};
static const int sizes[] = {@SIZES@}, doubles[] = {@DOUBLES@};
enum { COUNT = sizeof calls / sizeof *calls };
static int order(const void *a, const void *b) { double x = *(double *)a, y = *(double *)b; return (x > y) - (x < y); }
static double now(void) { struct timespec t; clock_gettime(CLOCK_MONOTONIC, &t); return 1e9 * t.tv_sec + t.tv_nsec; }
static void read(FILE *f, double *d, float *s, size_t n) {
  if (fread(d, 8, n, f) != n) exit(2);
  for (size_t i = 0; i < n; i++) s[i] = (float)d[i];
}
int main(int argc, char **argv) {
  FILE *f = fopen(argv[1], "rb");
  read(f, d_q, f_q, 7 * @ROWS@), read(f, d_qdot, f_qdot, 7 * @ROWS@), read(f, d_qddot, f_qddot, 7 * @ROWS@);
  read(f, d_pose, f_pose, 16 * @ROWS@), read(f, d_spheres, f_spheres, 4 * @SPHERES@);
  int rounds = atoi(argv[2]);
  for (int k = 0; k < COUNT; k++)
    for (long i = 0; i < @JUDGED@; i++) {
      calls[k](i);
      for (int j = 0; j < sizes[k]; j++) printf("%.17g ", doubles[k] ? d_out[j] : (double)f_out[j]);
      printf("\\n");
    }
  double *times = malloc(sizeof(double) * 2 * COUNT * rounds), *firsts = malloc(sizeof(double) * 2 * COUNT * rounds);
  for (int r = 0; r < rounds; r++)
    for (int on = 0; on < 2; on++)
      for (int k = 0; k < COUNT; k++) {
        long first = r % (@ROWS@ / @TURN@) * @TURN@;
        FLUSH(on);
        double start = now();
        calls[k](first);
        firsts[(2 * k + on) * rounds + r] = now() - start;
        for (long i = first + 1; i < first + @WARM@; i++) calls[k](i);
        start = now();
        for (long i = first; i < first + @TURN@; i++) calls[k](i);
        times[(2 * k + on) * rounds + r] = (now() - start) / @TURN@;
      }
  for (int k = 0; k < 2 * COUNT; k++) {
    qsort(times + k * rounds, rounds, sizeof(double), order);
    qsort(firsts + k * rounds, rounds, sizeof(double), order);
    const double *all = times + k * rounds;
    printf("%.3f %.3f %.3f %.3f\\n", all[rounds / 2], all[(int)(0.95 * rounds)], *all, firsts[k * rounds + rounds / 2]);
  }
  return argc != 3;
}
"""


def truth(model: Any, frame: Any, robot: jaxik.Robot, inputs: list[np.ndarray], spheres: np.ndarray) -> dict[str, np.ndarray]:
    """The judged results: of Pinocchio, and of NumPy at its poses; the robot's own pairs by `clearance`, which tests hold
    against coal."""
    data, (q, qdot, qddot), number = model.createData(), inputs, model.getFrameId(TIP)
    poses, torques = [], []
    for i in range(JUDGED):
        aligned = pin.computeFrameJacobian(model, data, q[i], number, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        poses.append(np.concatenate([data.oMf[number].homogeneous.ravel(), aligned.ravel()]))
        torques.append(pin.rnea(model, data, q[i], qdot[i], qddot[i]))
    gaps = np.array([[spheres_alone(model, data, capsules_of(robot), q[i], spheres)] for i in range(JUDGED)])
    with jax.enable_x64(True):
        itself = np.asarray(jax.jit(jax.vmap(lambda q: clearance(robot, None, q)))(q[:JUDGED]))[:, None]
    found = {"pose_and_jacobian": np.array(poses), "inverse_dynamics": np.array(torques)}
    return found | {"clearance_to_spheres": np.minimum(gaps, itself), "spheres alone": gaps}


def pose_at(model: Any, q: np.ndarray) -> np.ndarray:
    """The pose of the tip by Pinocchio."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId(TIP)].homogeneous


def spheres_alone(model: Any, data: Any, capsules: list[Any], q: np.ndarray, spheres: np.ndarray) -> float:
    """The least distance of capsules to spheres, by NumPy at Pinocchio's poses."""
    pin.forwardKinematics(model, data, q)
    least = np.inf
    for joint, a, b, radius in capsules:
        begin, end = (data.oMi[joint].act(np.asarray(x, float)) for x in (a, b))
        arm, along = spheres[:, :3] - begin, end - begin
        t = np.clip(arm @ along / (along @ along), 0.0, 1.0)
        least = min(least, float((np.linalg.norm(arm - t[:, None] * along, axis=1) - spheres[:, 3]).min()) - radius)
    return least


def surroundings(rng: np.random.Generator) -> np.ndarray:
    """Spheres of 3 cm in the upper half of a shell from 0.5 to 1.2 m around the base."""
    place = rng.normal(size=(SPHERES, 3))
    place *= rng.uniform(0.5, 1.2, (SPHERES, 1)) / np.linalg.norm(place, axis=1, keepdims=True)
    place[:, 2] = np.abs(place[:, 2])
    return np.column_stack([place, np.full(SPHERES, 0.03)])


def capsules_of(robot: jaxik.Robot) -> list[tuple[int, Any, Any, float]]:
    """The robot's volumes: capsules by their joint, counted from 1, or 0 for the base."""
    joint = lambda volume: int(robot.link_joint[volume.link])
    return [(joint(v), *map(np.asarray, v.corners), float(v.radius)) for v in robot.volumes]


def run(
    contenders: list[Contender], inputs: list[np.ndarray], spheres: np.ndarray, folder: Path, rounds: int
) -> tuple[Any, Any]:
    """The judged results and the times of all contenders, from one process."""
    calls = [f"static void run{k}(long i) {{ {each.call} }}" for k, each in enumerate(contenders)]
    filled = {
        "DECLARED": "\n".join(dict.fromkeys(each.declared for each in contenders)),
        "CALLS": "\n".join(calls),
        "NAMES": ", ".join(f"run{k}" for k in range(len(contenders))),
        "SIZES": ", ".join(str(sum(RESULTS[each.work])) for each in contenders),
        "DOUBLES": ", ".join(str(int(each.kind == "double")) for each in contenders),
        "ROWS": str(ROWS),
        "TURN": str(TURN),
        "WARM": str(WARM),
        "SPHERES": str(SPHERES),
        "JUDGED": str(JUDGED),
    }
    (folder / "race.c").write_text(re.sub(r"@(\w+)@", lambda found: filled[found[1]], HARNESS))
    (folder / "inputs").write_bytes(b"".join(np.asarray(x, np.float64).tobytes() for x in (*inputs, spheres)))
    objects = list(dict.fromkeys(each for contender in contenders for each in contender.objects))
    subprocess.run([*GCC, "race.c", *objects, "-lm", "-o", "race"], cwd=folder, check=True)
    told = subprocess.run(["./race", "inputs", str(rounds)], cwd=folder, check=True, capture_output=True, text=True).stdout
    lines = [list(map(float, line.split())) for line in told.splitlines()]
    split = JUDGED * len(contenders)
    return [lines[k * JUDGED : (k + 1) * JUDGED] for k in range(len(contenders))], lines[split:]


def main() -> None:
    """All functions; prints, and writes the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=1001)
    parser.add_argument("--only", choices=["jaxik"], help="no peers")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    arguments = parser.parse_args()
    file = str(urdf_file())
    model, bare, shaped = pin.buildModelFromUrdf(file), jaxik.load(file, tip=TIP), jaxik.load("panda")
    frame = model.frames[model.getFrameId(TIP)]
    rng = np.random.default_rng(0)
    inputs = [rng.uniform(bare.lower, bare.upper, (ROWS, 7)), *rng.normal(size=(2, ROWS, 7))]
    poses, spheres = np.array([pose_at(model, q) for q in inputs[0]]), surroundings(rng)
    functions = (
        {}
        if arguments.only
        else {
            "pose_and_jacobian": casadi_panda.pose_and_jacobian(model, frame),
            "inverse_dynamics": casadi_panda.inverse_dynamics(model),
            "clearance_to_spheres": casadi_panda.clearance_to_spheres(model, capsules_of(shaped), SPHERES),
        }
    )
    robots = {"pose_and_jacobian": bare, "inverse_dynamics": bare, "clearance_to_spheres": shaped, "ik": bare}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        peers = [] if arguments.only else [*casadis(functions, folder), *pinocchios(model, frame, folder)]
        contenders = [*ours(robots, folder), *peers]
        found, times = run(contenders, [*inputs, poses], spheres, folder, arguments.rounds)
    right = truth(model, frame, shaped, inputs, spheres)
    rows = []
    for k, each in enumerate(contenders):
        (ns, p95, least, first), (flushing, *_) = times[2 * k], times[2 * k + 1]
        if each.work == "ik":  # judged by where its answers lead
            found[k] = [pose_at(model, np.array(q)) for q in found[k]]
            right["ik"] = poses[:JUDGED]
        alone = each.work == "clearance_to_spheres" and each.who != "jaxik"
        error = float(np.abs(np.array(found[k]) - right["spheres alone" if alone else each.work]).max())
        rows.append({"work": each.work, "who": each.who, "kind": each.kind, "ns": ns, "ns_p95": p95, "ns_least": least})
        rows[-1] |= {"ns_flushing": flushing, "ns_first": first, "error": error, "bytes": each.size}
        print(json.dumps(rows[-1]))
    result = {"machine": machine(), "rows": rows, "spheres": SPHERES}
    arguments.out.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
