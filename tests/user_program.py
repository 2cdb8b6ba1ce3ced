"""What a user writes, against the installed package: it runs, and `mypy --strict` accepts it (`.ci/run`)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

import jaxik


def height(chain: jaxik.Chain, q: jax.Array) -> jax.Array:
    """Of the tip [m]; traced."""
    tip: jax.Array = jaxik.forward_kinematics(chain, q)
    return jnp.sum(tip[2, 3])


def answers(chain: jaxik.Chain, targets: np.ndarray, scene: jaxik.Scene | None = None) -> dict[str, int]:
    options = jaxik.IKOptions(max_seeds=32, margin=0.01)
    result = jaxik.solve_ik(chain, targets, scene, options=options)
    q: np.ndarray = result.q
    print(q.shape, [jaxik.Reason(int(r)).text for r in result.reason])
    return result.counts()


def main() -> None:
    chain = jaxik.load("p6r", ignore=[("base", "forearm")])
    scene = jaxik.load_scene("cucumber_row")
    middle = jnp.asarray((chain.lower + chain.upper) / 2)
    print(chain.num_joints, chain.joint_names, scene.counts)
    print(height(chain, middle), jax.grad(lambda q: height(chain, q))(middle))
    print(jaxik.clearance(chain, scene, q=middle), jaxik.motions.Line(np.eye(4), np.eye(4)).pose(0.5))
    print(answers(chain, np.asarray(jaxik.forward_kinematics(chain, middle))[None], scene))


if __name__ == "__main__":
    try:
        main()
    except jaxik.LoadError as error:
        raise SystemExit(str(error)) from None
