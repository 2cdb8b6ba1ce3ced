"""The demands on a posture among obstacles, and its rank: by its clearance, and by how free it is."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxik.collision.clearances import clearance
from jaxik.costs import joint_limit_margin
from jaxik.kinematics.robot import Robot
from jaxik.options import Options, number
from jaxik.spmd.host import host_kernels


class PostureOptions(Options, who="posture"):
    """The postures that count, and how they are ranked:

        score = clearance_weight * min(D, reach) / reach + freedom_weight * F

    with the clearance D [m] and the freedom F of the least free joint (`costs.joint_limit_margin`), both terms in [0, 1] times
    their weight.
    """

    margin: float = number(default=0.0, unit="m", words="least clearance")
    clearance_weight: float = number(default=1.0, least=0.0, words="weight of the clearance in the score")
    freedom_weight: float = number(default=0.5, least=0.0, words="weight of the least free joint's freedom in the score")
    reach: float = number(
        default=0.075, above=0.0, unit="m", words="clearance beyond which more is worth nothing, as in (6) of Van Henten 2010"
    )

    def score(self, clearance: np.ndarray, freedom: np.ndarray) -> np.ndarray:
        """The scores of postures of these clearances [m] and freedoms."""
        near = self.clearance_weight * np.clip(clearance, 0.0, self.reach) / self.reach
        return near + self.freedom_weight * np.clip(freedom, 0.0, 1.0)


@host_kernels(1)
def measures(robot: Robot, q: Any, scene: Any) -> Any:
    """The kernel of clearances [m] and freedoms, by rows of q."""
    return clearance(robot, scene, q), joint_limit_margin(robot, q)
