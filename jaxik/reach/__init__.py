"""Reach of an arm over all positions of its leading joints (a slide), or of its base on the floor, and proofs of what lies
between those that were tried."""

from jaxik.reach.floor import Floor, base_frames
from jaxik.reach.grasp import Grasp
from jaxik.reach.leading_joints import Postures, postures_over
from jaxik.reach.mobile_base import BasePoses, base_poses
from jaxik.reach.proof import ReachProof, prove_reach
from jaxik.reach.scoring import LikelyPostures, PostureOptions, likely_postures, log_reach_score, reach_score

__all__ = [
    "BasePoses",
    "Floor",
    "Grasp",
    "LikelyPostures",
    "PostureOptions",
    "Postures",
    "ReachProof",
    "base_frames",
    "base_poses",
    "likely_postures",
    "log_reach_score",
    "postures_over",
    "prove_reach",
    "reach_score",
]
