"""The behaviour of the nodes as pure state machines: messages in, messages out; no ROS, no clock, no I/O."""

from swarmabs_core.behaviours.agent import Agent, AgentGroup
from swarmabs_core.behaviours.base import Behaviour
from swarmabs_core.behaviours.controller import Controller, ControllerConfig
from swarmabs_core.behaviours.observer import Observer, ObserverConfig
from swarmabs_core.behaviours.parent import Parent
from swarmabs_core.behaviours.plane import PlaneConfig
from swarmabs_core.behaviours.robot import AgentConfig, LifeSpan
from swarmabs_core.behaviours.steering import Decision, Request, Steered, SteeringConfig, SteeringController
from swarmabs_core.robot_controller import Limits

__all__ = [
    "Agent",
    "AgentConfig",
    "AgentGroup",
    "Behaviour",
    "Controller",
    "ControllerConfig",
    "Decision",
    "LifeSpan",
    "Limits",
    "Observer",
    "ObserverConfig",
    "Parent",
    "PlaneConfig",
    "Request",
    "Steered",
    "SteeringConfig",
    "SteeringController",
]
