"""What is said on the socket of a run that is steered: JSON objects in lines, each answered (docs/steering.md)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from swarmabs_core.behaviours import Request
from swarmabs_core.errors import InputError
from swarmabs_core.messages import Action

LONGEST = 4096
"""Longest line, bytes."""

STATUS = "status"
VALUED = {"reference": Action.REFERENCE, "disturbance": Action.DISTURBANCE}
"""The actions that set a number."""
ROBOTS = {
    "kill": Action.KILL,
    "freeze": Action.FREEZE,
    "remove": Action.REMOVE,
    "leave": Action.REMOVE,
    "add": Action.ADD,
}
"""The actions that concern a robot; from outside a robot can only be removed, so that is what `leave` is."""

_Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]


class SteeringRequest(BaseModel):
    """One line: what somebody asks for.

    Parameters
    ----------
    action : str
        What is to be done; ``status`` only asks.
    value : float, optional
        Of ``reference`` in rad, of ``disturbance`` in N m.
    agent : int, optional
        The robot, for the others.
    request : str, optional
        What the client calls it. Who asks again under the same name gets the same answer, and nothing is done twice.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    action: Literal["reference", "disturbance", "kill", "freeze", "remove", "leave", "add", "status"]
    value: _Number | None = None
    agent: Annotated[int, Field(ge=1, le=65535)] | None = None
    request: Annotated[str, Field(min_length=1, max_length=100)] | None = None

    @model_validator(mode="after")
    def _check_fields(self) -> SteeringRequest:
        for name, given, actions in (("value", self.value, VALUED), ("agent", self.agent, ROBOTS)):
            if (given is not None) != (self.action in actions):
                raise ValueError(f"{self.action} {'needs' if given is None else 'takes no'} '{name}'")
        return self

    def wanted(self) -> Request:
        """Return it as what steers the run takes it."""
        if self.action in VALUED:
            return Request(VALUED[self.action], 0, (self.value or 0.0) + 0.0)
        return Request(ROBOTS[self.action], self.agent or 0)


def read_request(line: bytes) -> SteeringRequest:
    """Read a line.

    Raises
    ------
    InputError
        If it is not a valid one.
    """
    if len(line) > LONGEST:
        raise InputError(f"the line is longer than {LONGEST} bytes")
    try:
        return SteeringRequest.model_validate_json(line)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, first["loc"]))
        raise InputError(f"{where}: {first['msg']}" if where else first["msg"]) from error


def refusal(reason: str) -> dict[str, Any]:
    """Return the answer to what is not done."""
    return {"ok": False, "reason": reason}
