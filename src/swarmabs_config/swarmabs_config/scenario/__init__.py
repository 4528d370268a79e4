"""Scenarios, the complete descriptions of runs (docs/reference/scenario.md)."""

from swarmabs_config.model.agents import Agent
from swarmabs_config.model.errors import ScenarioError

from .checked import Scenario, json_schema
from .dump import dump_scenario
from .loader import load_scenario, parse_scenario

__all__ = ["Agent", "Scenario", "ScenarioError", "dump_scenario", "json_schema", "load_scenario", "parse_scenario"]
