"""What a user writes, for a type checker, against the installed package: `mypy --strict tests/user_program.py`."""

from __future__ import annotations

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxik


def reach(chain: jaxik.Chain, q: jax.Array) -> jax.Array:
    """How far the tip is [m]; traced."""
    tip: jax.Array = jaxik.forward_kinematics(chain, q)
    return jnp.linalg.norm(tip[:3, 3])


def answers(chain: jaxik.Chain, targets: np.ndarray, scene: jaxik.Scene | None = None) -> dict[str, int]:
    options = jaxik.IKOptions(max_seeds=32, margin=0.01)
    result = jaxik.solve_ik(chain, targets, scene, options=options)
    q: np.ndarray = result.q
    print(q.shape, [jaxik.Reason(int(r)).text for r in result.reason])
    return result.counts()


def main(file: Path) -> None:
    chain = jaxik.load(file, tip="tool0", ignore=[("base", "wrist")]).mounted(np.eye(4))
    scene = jaxik.load_scene("cucumber_row")
    print(chain.num_joints, chain.joint_names, chain.lower, scene.counts, chain.digest)
    print(jax.grad(lambda q: reach(chain, q))(jnp.zeros(chain.num_joints)))
    print(answers(chain, np.eye(4)[None], scene))
    print(jaxik.motions.Line(np.eye(4), np.eye(4)).pose(0.5))
    for row in jaxik.harvest(chain, scene).rows:
        print(row.fruit, row.reason.text, row.clearance)


if __name__ == "__main__":
    try:
        main(Path("robot.urdf"))
    except jaxik.LoadError as error:
        print(error)
