"""Scenarios: the one description of a run that everything is started from (docs/design.md, Scenario)."""

from .agents import Agent
from .dump import dump_scenario
from .errors import ScenarioError
from .loader import load_scenario, parse_scenario
from .model import Scenario, json_schema

__all__ = ["Agent", "Scenario", "ScenarioError", "dump_scenario", "json_schema", "load_scenario", "parse_scenario"]
