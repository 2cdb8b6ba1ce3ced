"""Plans that keep up with a world that changes: a handle that is told the world again and again, and its log."""

from jaxik.replanning.command import Command, Event
from jaxik.replanning.course import Course, Run
from jaxik.replanning.log import Log, Record, load_log
from jaxik.replanning.replan_options import ReplanOptions
from jaxik.replanning.replanner import Replanner

__all__ = ["Command", "Course", "Event", "Log", "Record", "ReplanOptions", "Replanner", "Run", "load_log"]
