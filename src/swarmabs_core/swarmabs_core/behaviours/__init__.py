"""The behaviour of the nodes as pure state machines: messages in, messages out; no ROS, no clock, no I/O."""

from swarmabs_core.behaviours.agent import Agent, AgentGroup
from swarmabs_core.behaviours.base import Behaviour
from swarmabs_core.behaviours.controller import Controller
from swarmabs_core.behaviours.observer import Observer
from swarmabs_core.behaviours.parent import Parent
from swarmabs_core.behaviours.patience import Patience
from swarmabs_core.behaviours.peer import Peer, PeerGroup
from swarmabs_core.behaviours.steering import Decision, Request, Steered, SteeringConfig, SteeringController

__all__ = [
    "Agent",
    "AgentGroup",
    "Behaviour",
    "Controller",
    "Decision",
    "Observer",
    "Parent",
    "Patience",
    "Peer",
    "PeerGroup",
    "Request",
    "Steered",
    "SteeringConfig",
    "SteeringController",
]
