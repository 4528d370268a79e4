"""Scenarios, the complete descriptions of runs (docs/reference/scenario.md)."""

from swarmabs_config.model.agents import Agent
from swarmabs_config.model.errors import ScenarioError
from swarmabs_config.model.scenario import PlaneScenario, Scenario, SystemScenario, json_schema, on_plane

from .checks import warnings_of
from .dump import dump_scenario
from .loader import load_scenario, parse_scenario

__all__ = [
    "Agent",
    "PlaneScenario",
    "Scenario",
    "ScenarioError",
    "SystemScenario",
    "dump_scenario",
    "json_schema",
    "load_scenario",
    "on_plane",
    "parse_scenario",
    "warnings_of",
]
