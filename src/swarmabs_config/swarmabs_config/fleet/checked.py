"""The checked fleet: what involves several settings holds too."""

from __future__ import annotations

from pydantic import model_validator

from swarmabs_config.fleet import checks
from swarmabs_config.fleet.model import UncheckedFleet
from swarmabs_config.model.fields import raise_findings


class Fleet(UncheckedFleet):
    """A fleet, completely described apart from its scenario. Build it with `load_fleet`, which names file and line."""

    @model_validator(mode="after")
    def _check_together(self) -> Fleet:
        raise_findings(checks.findings(self))
        return self

    def warnings(self) -> tuple[str, ...]:
        """Return what is legal but likely to go wrong, one line each."""
        return checks.warnings(self)
