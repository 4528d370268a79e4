"""The canonical text of a resolved scenario."""

import json
import re
from collections.abc import Iterator

from swarmabs_config.model.scenario import Scenario

from .yaml_tree import Plain

_PLAIN_TEXT = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_WORDS_OF_YAML = {"y", "n", "yes", "no", "on", "off", "true", "false", "null"}


def dump_scenario(scenario: Scenario) -> str:
    """Return a scenario as YAML with every default filled in and every robot listed.

    The text is canonical: equal scenarios give equal texts, and the text loads back to
    ``scenario.resolved()``. Numbers have as many digits as they need, written so that YAML 1.1 and 1.2
    readers read the same number.
    """
    data = scenario.resolved().model_dump(mode="json", by_alias=True)
    data["swarm"].pop("generate", None)
    return dump_tree(data)


def dump_tree(data: dict[str, Plain]) -> str:
    """Return a mapping as YAML that `read_tree` reads back; keys are plain names, dotted or not."""
    return "".join(f"{line}\n" for line in _block(data, ""))


def _block(mapping: dict[str, Plain], indent: str) -> Iterator[str]:
    for key, value in mapping.items():
        if isinstance(value, dict) and value:
            yield f"{indent}{key}:"
            yield from _block(value, f"{indent}  ")
        elif isinstance(value, list) and any(isinstance(item, dict) for item in value):
            yield f"{indent}{key}:"
            yield from (f"{indent}  - {_flow(item)}" for item in value)
        else:
            yield f"{indent}{key}: {_flow(value)}"


def _flow(value: Plain) -> str:
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_flow(item)}' for key, item in value.items())}}}"
    if isinstance(value, list):
        return f"[{', '.join(_flow(item) for item in value)}]"
    if isinstance(value, float):
        text = repr(value)
        return text if "." in text else text.replace("e", ".0e")  # YAML 1.1 takes 1e-05 for a text
    if isinstance(value, str):
        return value if _PLAIN_TEXT.fullmatch(value) and value.lower() not in _WORDS_OF_YAML else _quoted(value)
    return json.dumps(value)


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
