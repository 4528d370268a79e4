"""The JSON Schema of scenario files, for editors."""

from .model import Scenario


def json_schema() -> dict[str, object]:
    """Return the JSON Schema (2020-12) of a scenario file, with the registered controllers and trajectories.

    It covers names, types, units and ranges. What involves several fields at once is not in it: that is
    checked when a scenario is loaded.
    """
    schema = Scenario.model_json_schema(by_alias=True, mode="validation")
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "swarmabs scenario"
    return schema
