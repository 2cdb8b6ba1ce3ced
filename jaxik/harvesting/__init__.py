"""Fruits, how they are grasped, and the best posture for each."""

from jaxik.harvesting import crop
from jaxik.harvesting.blocking_objects import blockers
from jaxik.harvesting.driver import Harvest, HarvestOptions, harvest
from jaxik.harvesting.grasp import Grasp
from jaxik.harvesting.harvest_plan import Cycle, HarvestPlan, HarvestPlanOptions, Stage
from jaxik.harvesting.harvest_plan_files import save_harvest_plan
from jaxik.harvesting.harvest_planner import plan_harvest
from jaxik.harvesting.scanning import Weights, scan

__all__ = [
    "Cycle",
    "Grasp",
    "Harvest",
    "HarvestOptions",
    "HarvestPlan",
    "HarvestPlanOptions",
    "Stage",
    "Weights",
    "blockers",
    "crop",
    "harvest",
    "plan_harvest",
    "save_harvest_plan",
    "scan",
]
