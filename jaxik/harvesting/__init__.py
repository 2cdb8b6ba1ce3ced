"""Fruits, how they are grasped, and the best posture for each."""

from jaxik.harvesting.blocking_objects import Blockers
from jaxik.harvesting.crop import make_row
from jaxik.harvesting.driver import HarvestOptions, HarvestResult, harvest
from jaxik.harvesting.harvest_plan import HarvestMotion, HarvestPlan, HarvestPlanOptions, Stage, save_harvest
from jaxik.harvesting.harvest_planner import plan_harvest
from jaxik.harvesting.scanning import ScanOptions, ScanResult, scan
from jaxik.reach.grasp import Grasp

__all__ = [
    "Blockers",
    "Grasp",
    "HarvestMotion",
    "HarvestOptions",
    "HarvestPlan",
    "HarvestPlanOptions",
    "HarvestResult",
    "ScanOptions",
    "ScanResult",
    "Stage",
    "harvest",
    "make_row",
    "plan_harvest",
    "save_harvest",
    "scan",
]
