"""A scenario that has also passed the checks across fields."""

from pydantic import model_validator

from swarmabs_config.model.fields import raise_findings, schema_of
from swarmabs_config.model.scenario import UncheckedScenario

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


def json_schema() -> dict[str, object]:
    """Return the JSON Schema (2020-12) of a scenario file, with the registered controllers and trajectories.

    It covers names, types, units and ranges. Checks across fields are made when a scenario is loaded.
    """
    return schema_of(Scenario, "swarmabs scenario")
