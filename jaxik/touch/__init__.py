"""Touch: sensors, where a contact is, how stiff, and reactions to it."""

from jaxik.touch.force_law import StiffnessEstimator
from jaxik.touch.reaction import Reaction, ReactionCommand
from jaxik.touch.reaction_simulation import Encounter, ReactionResult, SpringContact, simulate_reaction
from jaxik.touch.sensors import Located, Skin, TouchSensor, locate_contact

__all__ = [
    "Encounter",
    "Located",
    "Reaction",
    "ReactionCommand",
    "ReactionResult",
    "Skin",
    "SpringContact",
    "StiffnessEstimator",
    "TouchSensor",
    "locate_contact",
    "simulate_reaction",
]
