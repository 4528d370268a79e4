"""A scenario that has also passed the checks across fields."""

from pydantic import model_validator

from swarmabs_config.model.fields import raise_findings, schema_of
from swarmabs_config.model.scenario import AnyScenario, UncheckedScenario, UncheckedSystemScenario
from swarmabs_core.errors import InputError
from swarmabs_core.systems.interface import SYSTEMS

from . import checks


class Scenario(UncheckedScenario):
    """A complete, valid description of a run.

    Instances are immutable. Build them with `load_scenario` or `parse_scenario`, whose errors name file and line, or
    directly; then an invalid value raises `pydantic.ValidationError`.
    """

    @model_validator(mode="after")
    def _check_together(self) -> "Scenario":
        raise_findings(checks.findings(self))
        return self

    def resolved(self) -> "Scenario":
        """Return the same scenario with every robot listed, in order of ids, and nothing left to generate."""
        swarm = self.swarm.model_copy(update={"agents": self.agents, "generate": None})
        return self.model_copy(update={"swarm": swarm})

    def warnings(self) -> tuple[str, ...]:
        """Return one line for each setting that is valid but likely to cause trouble."""
        return checks.warnings(self)


class SystemScenario(UncheckedSystemScenario):
    """A complete, valid description of a run on a parent system of an installed package; like `Scenario`."""

    @model_validator(mode="after")
    def _check_together(self) -> "SystemScenario":
        raise_findings(checks.system_findings(self))
        return self

    def resolved(self) -> "SystemScenario":
        """Return the same scenario with every robot listed, in order of ids, and nothing left to generate."""
        swarm = self.swarm.model_copy(update={"agents": self.agents, "generate": None})
        return self.model_copy(update={"swarm": swarm})

    def warnings(self) -> tuple[str, ...]:
        """Return one line for each setting that is valid but likely to cause trouble."""
        return checks.system_warnings(self)


def json_schema() -> dict[str, object]:
    """Return the JSON Schema (2020-12) of a scenario file, with the registered controllers and trajectories.

    If packages provide parent systems, it branches on the key ``system``. It covers names, types, units and ranges.
    Checks across fields are made when a scenario is loaded.
    """
    plane = schema_of(Scenario, "swarmabs scenario")
    if not len(SYSTEMS):
        return plane
    system = schema_of(SystemScenario, "swarmabs scenario")
    definitions: dict[str, object] = {}
    for schema in (plane, system):
        definitions.update(schema.pop("$defs"))  # type: ignore[call-overload]  # a mapping
    head = {name: plane[name] for name in ("$schema", "title", "description")}
    return {**head, "$defs": definitions, "if": {"required": ["system"]}, "then": system, "else": plane}


def on_plane(scenario: AnyScenario, what: str) -> Scenario:
    """Return a scenario on the plane; raise `InputError` for any other, which `what` does not support."""
    if isinstance(scenario, Scenario):
        return scenario
    system = getattr(scenario, "system", None)
    raise InputError(f"{what} supports only the plane, not the parent system {getattr(system, 'type', '')!r}")
