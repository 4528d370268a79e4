"""Whether a value fits a JSON Schema, for the part of it that is used here."""

import math
from typing import Any


def in_range(value: float, schema: dict[str, Any]) -> bool:
    low, high = schema.get("minimum", -math.inf), schema.get("maximum", math.inf)
    above, below = schema.get("exclusiveMinimum", -math.inf), schema.get("exclusiveMaximum", math.inf)
    return bool(low <= value <= high and above < value < below)


def of_type(value: object, name: str | None) -> bool:
    if name in {"number", "integer"}:
        return isinstance(value, (int, float) if name == "number" else int) and not isinstance(value, bool)
    kinds = {"object": dict, "array": list, "string": str, "null": type(None), "boolean": bool, None: object}
    return isinstance(value, kinds[name])


def fits(value: object, schema: dict[str, Any], root: dict[str, Any] | None = None) -> bool:
    """Say whether `value` fits a schema, which is part of a root if it is not one itself."""
    root = root or schema
    choices = [fits(value, choice, root) for choice in schema.get("oneOf", ())]
    checks = [
        "$ref" not in schema or fits(value, root["$defs"][schema["$ref"].removeprefix("#/$defs/")], root),
        value == schema.get("const", value),
        value in schema.get("enum", [value]),
        "oneOf" not in schema or choices.count(True) == 1,
        "anyOf" not in schema or any(fits(value, choice, root) for choice in schema["anyOf"]),
        of_type(value, schema.get("type")),
    ]
    if not all(checks):
        return False
    if isinstance(value, int | float):
        return in_range(value, schema)
    if isinstance(value, dict):
        properties = schema.get("properties", {})
        return (
            (schema.get("additionalProperties", True) or value.keys() <= properties.keys())
            and value.keys() >= set(schema.get("required", ()))
            and all(fits(value[key], properties[key], root) for key in value.keys() & properties.keys())
        )
    if isinstance(value, list):
        items = schema.get("prefixItems", [schema.get("items", {})] * len(value))
        return schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", math.inf) and all(
            fits(item, part, root) for item, part in zip(value, items, strict=True)
        )
    return True
