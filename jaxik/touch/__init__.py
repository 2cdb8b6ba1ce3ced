"""Touch: sensors, where a contact is, how stiff, and reactions to it."""

from jaxik.touch.contact_location import Located, locate_contact
from jaxik.touch.force_law import ForceLaw
from jaxik.touch.reaction import Reaction, ReactionCommand, ReactionState
from jaxik.touch.reaction_loop import ReactionLoop
from jaxik.touch.reaction_simulation import Encounter, Reacted, simulate_reaction
from jaxik.touch.sensors import Skin, TouchSensor
from jaxik.touch.spring_contact import SpringContact, contact_cost
from jaxik.touch.stiffness import StiffnessEstimator

__all__ = [
    "Encounter",
    "ForceLaw",
    "Located",
    "Reacted",
    "Reaction",
    "ReactionCommand",
    "ReactionLoop",
    "ReactionState",
    "Skin",
    "SpringContact",
    "StiffnessEstimator",
    "TouchSensor",
    "contact_cost",
    "locate_contact",
    "simulate_reaction",
]
