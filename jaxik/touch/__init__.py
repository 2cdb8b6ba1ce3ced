"""Touch: sensors, where a contact is, how stiff, and reactions to it."""

from jaxik.touch.contact_location import Located, locate_contact
from jaxik.touch.reaction import Reaction, ReactionCommand
from jaxik.touch.reaction_simulation import Encounter, ReactionResult, simulate_reaction
from jaxik.touch.sensors import Skin, TouchSensor
from jaxik.touch.spring_contact import SpringContact
from jaxik.touch.stiffness import StiffnessEstimator

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
