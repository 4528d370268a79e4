"""Scenarios: the one description of a run that everything is started from (docs/design.md, Scenario)."""

from swarmabs_core.behaviours.base import Lockstep
from swarmabs_core.manifold import Manifold
from swarmabs_core.plant import Disturbance, Plane
from swarmabs_core.robot_controller import Limits
from swarmabs_core.swarm_law import SwarmGains
from swarmabs_core.trajectory import Constant, QuinticStep, Sine

from .agents import AGENT_KINDS, Agent, DoubleIntegratorAgent, Generate, SingleIntegratorAgent
from .checks import spread
from .controllers import (
    CONTROLLER_CONFIGS,
    TRAJECTORY_CONFIGS,
    AriseConfig,
    ControllerConfig,
    CsvTrajectory,
    LqrConfig,
    PdConfig,
)
from .dump import dump_scenario
from .errors import ScenarioError
from .loader import load_scenario, parse_scenario
from .model import FAULT_KINDS, OBSERVERS, Scenario, Swarm, json_schema

__all__ = [
    "AGENT_KINDS",
    "CONTROLLER_CONFIGS",
    "FAULT_KINDS",
    "OBSERVERS",
    "TRAJECTORY_CONFIGS",
    "Agent",
    "AriseConfig",
    "Constant",
    "ControllerConfig",
    "CsvTrajectory",
    "Disturbance",
    "DoubleIntegratorAgent",
    "Generate",
    "Limits",
    "Lockstep",
    "LqrConfig",
    "Manifold",
    "PdConfig",
    "Plane",
    "QuinticStep",
    "Scenario",
    "ScenarioError",
    "Sine",
    "SingleIntegratorAgent",
    "Swarm",
    "SwarmGains",
    "dump_scenario",
    "json_schema",
    "load_scenario",
    "parse_scenario",
    "spread",
]
