"""What an arm reaches over all positions of its leading joints (a slide), and what lies between those that were tried."""

from jaxik.reach.grasp import Grasp
from jaxik.reach.ranking import PostureOptions
from jaxik.reach.scoring import likely_postures, log_reach_score, reach_score

__all__ = ["Grasp", "PostureOptions", "likely_postures", "log_reach_score", "reach_score"]
