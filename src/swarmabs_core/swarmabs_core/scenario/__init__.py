"""Scenarios: the one description of a run that everything is started from (docs/design.md, Scenario)."""

from swarmabs_core.theory.constraint_sets import largest_position

from .agents import AGENT_KINDS, Agent, DoubleIntegratorAgent, Generate, SingleIntegratorAgent
from .checks import spread
from .controllers import (
    CONTROLLER_CONFIGS,
    TRAJECTORY_CONFIGS,
    AriseConfig,
    ConstantTrajectory,
    ControllerConfig,
    CsvTrajectory,
    LqrConfig,
    PdConfig,
    QuinticTrajectory,
    SineTrajectory,
    TrajectoryConfig,
)
from .dump import dump_scenario
from .errors import ScenarioError
from .faults import (
    FAULT_KINDS,
    AgentFault,
    ClockOffsetFault,
    DelayFault,
    DuplicationFault,
    Fault,
    FreezeFault,
    JoinFault,
    KillFault,
    LeaveFault,
    LieFault,
    LossFault,
    MessageFault,
    ReorderingFault,
    RobotFault,
    SingleRobotFault,
)
from .loader import load_scenario, parse_scenario
from .model import Disturbance, Limits, Lockstep, Manifold, Plane, Scenario, Swarm, SwarmGains
from .observers import OBSERVER_CONFIGS, ObserverConfig, ParentResponseObserver, SumObserver
from .schema import json_schema

__all__ = [
    "AGENT_KINDS",
    "CONTROLLER_CONFIGS",
    "FAULT_KINDS",
    "OBSERVER_CONFIGS",
    "TRAJECTORY_CONFIGS",
    "Agent",
    "AgentFault",
    "AriseConfig",
    "ClockOffsetFault",
    "ConstantTrajectory",
    "ControllerConfig",
    "CsvTrajectory",
    "DelayFault",
    "Disturbance",
    "DoubleIntegratorAgent",
    "DuplicationFault",
    "Fault",
    "FreezeFault",
    "Generate",
    "JoinFault",
    "KillFault",
    "LeaveFault",
    "LieFault",
    "Limits",
    "Lockstep",
    "LossFault",
    "LqrConfig",
    "Manifold",
    "MessageFault",
    "ObserverConfig",
    "ParentResponseObserver",
    "PdConfig",
    "Plane",
    "QuinticTrajectory",
    "ReorderingFault",
    "RobotFault",
    "Scenario",
    "ScenarioError",
    "SineTrajectory",
    "SingleIntegratorAgent",
    "SingleRobotFault",
    "SumObserver",
    "Swarm",
    "SwarmGains",
    "TrajectoryConfig",
    "dump_scenario",
    "json_schema",
    "largest_position",
    "load_scenario",
    "parse_scenario",
    "spread",
]
