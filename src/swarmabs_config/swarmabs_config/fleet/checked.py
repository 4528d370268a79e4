"""A fleet that has also passed the checks across fields."""

from __future__ import annotations

from pydantic import model_validator

from swarmabs_config.fleet import checks
from swarmabs_config.fleet.model import UncheckedFleet
from swarmabs_config.model.fields import raise_findings


class Fleet(UncheckedFleet):
    """A complete, valid fleet without its scenario. Build it with `load_fleet`, whose errors name file and line."""

    @model_validator(mode="after")
    def _check_together(self) -> Fleet:
        raise_findings(checks.findings(self))
        return self

    def warnings(self) -> tuple[str, ...]:
        """Return one line for each setting that is valid but likely to cause trouble."""
        return checks.warnings(self)
