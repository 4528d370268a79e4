"""What the nodes do, as pure state machines: messages in, messages out; no ROS, no clock, no I/O."""

from swarmabs_core.behaviours.agent import Agent, AgentConfig, LifeSpan
from swarmabs_core.behaviours.base import Behaviour
from swarmabs_core.behaviours.controller import Controller, ControllerConfig
from swarmabs_core.behaviours.faulty import FaultyAgent, make_agent, with_faults
from swarmabs_core.behaviours.group import AgentGroup
from swarmabs_core.behaviours.observer import Observer, ObserverConfig
from swarmabs_core.behaviours.packing import Listener, PackingController, Unpacking
from swarmabs_core.behaviours.plane import Plane, PlaneConfig
from swarmabs_core.behaviours.steered import Newcomer, Orders, Steered, make_newcomer
from swarmabs_core.behaviours.steering_controller import Decision, Request, SteeringConfig, SteeringController
from swarmabs_core.robot_controller import Limits

__all__ = [
    "Agent",
    "AgentConfig",
    "AgentGroup",
    "Behaviour",
    "Controller",
    "ControllerConfig",
    "Decision",
    "FaultyAgent",
    "LifeSpan",
    "Limits",
    "Listener",
    "Newcomer",
    "Observer",
    "ObserverConfig",
    "Orders",
    "PackingController",
    "Plane",
    "PlaneConfig",
    "Request",
    "Steered",
    "SteeringConfig",
    "SteeringController",
    "Unpacking",
    "make_agent",
    "make_newcomer",
    "with_faults",
]
