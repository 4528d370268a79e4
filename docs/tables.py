"""Generate the tables of the pages in docs, and the schema of the view's messages: python docs/tables.py.

A table is between the lines ``<!-- table: NAME -->`` and ``<!-- end -->`` and is replaced. A test fails if a table is
out of date.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, cast, get_args, get_type_hints
from xml.etree import ElementTree as ET

import click
from pydantic import BaseModel

import abstraction_observer.node
import abstraction_observer.realtime
import agent_node.group
import agent_node.node
import agent_node.realtime
import parent_controller.node
import parent_controller.realtime
import plane_sim.driver
import plane_sim.node
import plane_sim.realtime
from swarmabs_analysis.losses.check import THRESHOLDS
from swarmabs_bag.recorder import node as recorder, realtime as realtime_recorder
from swarmabs_cli import SECTIONS, swarm
from swarmabs_config.graph import GRAPH, LOCKSTEP, REALTIME, RECORDER, End, Link
from swarmabs_config.model.agents import AGENT_KINDS, SystemAgent
from swarmabs_config.model.controllers import CONTROLLER_CONFIGS, TRAJECTORY_CONFIGS
from swarmabs_config.model.declared import Declared, DeclaredModel, model_of
from swarmabs_config.model.scenario import FAULT_KINDS, OBSERVERS
from swarmabs_config.scenario import PlaneScenario, SystemScenario
from swarmabs_core.controllers import CONTROLLERS
from swarmabs_core.declaration import parameters_of
from swarmabs_core.events import EventCode
from swarmabs_core.messages import TOPICS
from swarmabs_core.parameters import Parameter
from swarmabs_core.realtime.instruments import TopicSettings
from swarmabs_core.systems.interface import TABLES, Constant, Need, ParentController, ParentSystem, Quantity, Tracked
from swarmabs_ros.parameters import BySystem
from swarmabs_ros.realtime_runner import COMMON as REALTIME_COMMON
from swarmabs_ros.runner import COMMON
from swarmabs_ros.settings import LockstepSettings, RealtimeSettings
from swarmabs_run.steering import node as steering
from swarmabs_view.protocol import json_schema

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping


DOCS = Path(__file__).parent
VIEW_SCHEMA = DOCS / "reference" / "view_messages.schema.json"
SOURCES = DOCS.parent / "src"
MESSAGES = SOURCES / "swarmabs_msgs" / "msg"
_CHOSEN = {
    "controller": "`{type: pd}`",
    "observer": "`{type: sum}`",
    "swarm.law": "`{type: paper}`",
    "swarm.agents": "see below",
    "faults": "`[]`",
}
"""Fields whose content depends on a key in them, with their defaults."""
PUBLIC = (
    "swarmabs_config.scenarios",
    "swarmabs_config.scenario",
    "swarmabs_run.simulation",
    "swarmabs_run.simulated_run",
    "swarmabs_bag.arrays",
    "swarmabs_bag.reader",
    "swarmabs_bag.info",
    "swarmabs_bag.repair",
    "swarmabs_bag.merge",
    "swarmabs_analysis.verification",
    "swarmabs_analysis.comparison.bags",
    "swarmabs_analysis.export",
    "swarmabs_analysis.losses.check",
    "swarmabs_analysis.step_response",
    "swarmabs_analysis.sweep",
    "swarmabs_core.registry",
    "swarmabs_core.controllers",
    "swarmabs_core.swarm_law",
    "swarmabs_core.systems",
    "swarmabs_core.declaration",
    "swarmabs_core.messages",
    "swarmabs_core.theory",
)
"""Public modules, for programs, notebooks and extension packages."""
_TABLE = re.compile(r"(<!-- table: ([a-z_ ]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def table(headings: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a Markdown table."""
    lines = [list(headings)]
    lines += [["---"] * len(lines[0]), *([cell.replace("|", r"\|") for cell in row] for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def code(text: object) -> str:
    """Return a text formatted as code."""
    return f"`{text}`"


def value(given: object) -> str:
    """Return a default as written in YAML."""
    if given is None:
        return code("null")
    if isinstance(given, bool):
        return code(str(given).lower())
    if isinstance(given, (tuple, list)):
        return code("[" + ", ".join(f"{item:g}" if isinstance(item, float) else str(item) for item in given) + "]")
    if given == "":
        return code("''")
    return code(repr(given) if isinstance(given, float) else given)


def bounds(parameter: Parameter) -> str:
    """Describe the allowed values of a parameter."""
    found = []
    if parameter.length is not None:
        found.append(f"{parameter.length} numbers")
    if parameter.above is not None:
        found.append(f"> {parameter.above:g}")
    if parameter.below is not None:
        found.append(f"< {parameter.below:g}")
    if parameter.minimum is not None:
        found.append(f">= {parameter.minimum:g}")
    if parameter.maximum is not None:
        found.append(f"<= {parameter.maximum:g}")
    if parameter.choices is not None:
        found.append(", ".join(map(code, parameter.choices)))
    return "; ".join(found)


def parameters(declared: Iterable[type | BySystem[object]], without: Iterable[Parameter] = ()) -> str:
    """Return the table of a node's parameters on the plane, `without` the common ones."""
    names = {each.name for each in without}
    parts = (each.plane if isinstance(each, BySystem) else each for each in declared)
    found = (p for each in parts for p in parameters_of(each))
    rows = ((code(p.name), value(p.default), bounds(p), p.text) for p in found if p.name not in names)
    return table(("parameter", "default", "allowed", "meaning"), rows)


def topics() -> str:
    """Return the table of topics: type, offered QoS, publishers and subscribers."""

    def quality(link: Link) -> str:
        qos = link.offered.get(LOCKSTEP) or link.offered[REALTIME]
        return f"{qos.reliability}, {qos.durability}, {qos.depth}"

    def nodes(ends: tuple[End, ...]) -> str:
        return ", ".join(dict.fromkeys(f"{code(end.node)}{_conditions(end)}" for end in ends))

    return table(
        ("topic", "type", "QoS offered", "published by", "read by"),
        (
            (
                ", ".join(code(topic.name) for topic in link.topics),
                ", ".join(topic.type_name for topic in link.topics),
                quality(link),
                nodes(link.writers),
                nodes(link.readers),
            )
            for link in GRAPH
        ),
    )


def _conditions(end: End) -> str:
    """Describe when an end of a topic exists; empty if always."""
    found = [] if end.driver is None or end.node == RECORDER else [end.driver.value]
    found += [] if end.only is None else [end.only.value]
    found += [] if end.unless is None else [f"not {end.unless.value}"]
    return f" ({', '.join(found)})" if found else ""


def realtime_qos() -> str:
    """Return the table of the QoS offered in real time."""
    return table(
        ("topic", "QoS offered", "lease"),
        (
            (
                code(link.topic.name),
                f"{qos.reliability}, {qos.durability}, {qos.depth}",
                f"{qos.lease:g} s, by topic" if qos.lease else "none",
            )
            for link in GRAPH
            for qos in filter(None, (link.offered.get(REALTIME),))
        ),
    )


def message_fields() -> str:
    """Return the table of the fields of all messages, from the comments of their definitions."""
    rows = []
    for type_name in dict.fromkeys(topic.type_name for topic in TOPICS):
        name = type_name
        text = (MESSAGES / f"{name}.msg").read_text(encoding="utf-8")
        for kind, field, comment in re.findall(r"^(\w+(?:\[.*?\])?) ([a-z]\w*) +# (.*)$", text, re.MULTILINE):
            if field not in {"step", "system"}:
                rows.append((name, code(f"{kind} {field}"), comment))
                name = ""
    return table(("message", "field", "meaning"), rows)


def events() -> str:
    """Return the table of the kinds of events."""
    text = (MESSAGES / "SwarmEvent.msg").read_text(encoding="utf-8")
    found = re.findall(r"^uint8 ([A-Z_]+)=(\d+) +# (.*)$", text, re.MULTILINE)
    return table(("kind", "value", "meaning"), ((code(name), number, comment) for name, number, comment in found))


def event_codes() -> str:
    """Return the table of the publishers of events, by kind and text."""
    rows = []
    for each in EventCode:
        source = each.source.value if each.source is not None else "any other node"
        text = re.sub(r"{\w+}", "...", each.text)
        alone = sum(one.kind is each.kind for one in EventCode) == 1
        other = "any" if alone else "any other"
        rows.append((code(each.kind.name), code(text) if text else other, source))
    return table(("kind", "`detail`", "published by"), rows)


def leaves(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, str, str]]:
    """Return path, default and meaning of every field of a part of a scenario."""
    hints = {} if issubclass(model, DeclaredModel) else get_type_hints(model)
    for name, field in model.model_fields.items():
        path = f"{prefix}{field.alias or name}"
        described = field.description or ""
        candidates = [hints.get(name), *get_args(hints.get(name))]
        inner = next((c for c in candidates if isinstance(c, type) and issubclass(c, BaseModel)), None)
        if any(isinstance(each, Declared) for each in field.metadata):
            inner = model_of(cast("type", field.annotation))
        if path in _CHOSEN or path.endswith("trajectory"):
            yield path, _CHOSEN.get(path, "see below"), described
        elif inner is not None:
            yield from leaves(inner, f"{path}.")
        else:
            yield path, "required" if field.is_required() else value(field.get_default()), described


def fields(rows: Iterable[tuple[str, str, str]]) -> str:
    """Return a table of fields of a scenario."""
    return table(("field", "default", "meaning"), ((code(path), default, text) for path, default, text in rows))


def variants(models: Mapping[str, type[BaseModel]], key: str) -> str:
    """Return a table of fields that depend on a key such as ``kind``."""
    rows = []
    for name, model in models.items():
        shown = f"{key}: {name}"
        for path, default, text in leaves(model):
            if path != key:
                rows.append((code(shown) if shown else "", code(path), default, text))
                shown = ""
        if shown:
            rows.append((code(shown), "", "", ""))
    return table(("where", "field", "default", "meaning"), rows)


def controller_parameters() -> str:
    """Return the table of the parameters that each control law adds to those of the parent controller."""
    rows = [
        (name, code(f"controller.{p.name}"), value(p.default), bounds(p), p.text)
        for name, entry in CONTROLLERS.built_in.items()
        for p in entry.settings
    ]
    return table(("law", "parameter", "default", "allowed", "meaning"), rows)


def commands(section: str) -> str:
    """Return the description of the commands of a section, with arguments, options and examples."""
    context = click.Context(swarm, info_name="./scripts/swarm")
    names = [name for name in swarm.list_commands(context) if _section(swarm.get_command(context, name)) == section]
    return "\n".join(part for name in names for part in _described(swarm, name, context))


def _section(command: click.Command | None) -> str:
    """Return the folder of a command."""
    return "" if command is None else command.callback.__module__.split(".")[1]


def _described(group: click.Group, name: str, parent: click.Context) -> Iterator[str]:
    """Yield the parts of the description of a command, or of all commands of a group."""
    command = group.get_command(parent, name)
    if command is None:
        raise ValueError(f"no command {name}")
    context = click.Context(command, info_name=name, parent=parent)
    if isinstance(command, click.Group):
        for inner in command.list_commands(context):
            yield from _described(command, inner, context)
        return
    yield f"### {context.command_path.partition(' ')[2]}\n"
    yield f"{_help(command)}\n"
    yield f"```text\n{' '.join([context.command_path, *command.collect_usage_pieces(context)])}\n```\n"
    options = [_option(found, context) for found in command.params if isinstance(found, click.Option)]
    if options:
        yield table(("option", "meaning"), options)
    if shown := re.findall(r"^ +(.*swarm.*)$", command.epilog or "", re.MULTILINE):
        yield "Examples:\n\n```sh\n" + "".join(f"{line}\n" for line in shown) + "```\n"


def _help(command: click.Command) -> str:
    """Return the help of a command as paragraphs."""
    paragraphs = inspect.cleandoc(command.help or "").replace("\b\n", "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


def _option(found: click.Option, context: click.Context) -> tuple[str, str]:
    """Return the syntax of an option, and its meaning with the default."""
    *others, last = found.opts
    kind = "PATH" if isinstance(found.type, click.Path) else "NUMBER"
    if isinstance(found.type, click.Choice):
        kind = "|".join(found.type.choices)
    shown = [*others, last if found.is_flag else f"{last} {found.metavar or kind}"]
    extra = found.get_help_extra(context).get("default")
    meaning = " ".join((found.help or "").split())
    return ", ".join(map(code, shown)), meaning + (f" Default: {code(extra)}." if extra else "")


def parent_system() -> str:
    """Return the table of the interface of parent systems: rows of its tables, members, optional methods."""
    rows = [
        (code(f"{each.__name__}({', '.join(each._fields)})"), " ".join(inspect.cleandoc(each.__doc__ or "").split()))
        for each in (Quantity, Constant, Need, Tracked)
    ]
    text = inspect.getsource(ParentSystem)
    size = {name: f"; {least} to {most} rows" for name, (_, least, most) in TABLES.items()}
    for name, kind, said in re.findall(r'^    (\w+): (.+)\n    """(.+)\."""$', text, re.MULTILINE):
        rows.append((code(f"{name}: {kind}"), f"{said}{size.get(name, '')}."))
    for of, whose in ((ParentSystem, ""), (ParentController, " of the controller")):
        for name, method in vars(of).items():
            if inspect.isfunction(method) and not name.startswith("_"):
                words = ", ".join(list(inspect.signature(method).parameters)[1:])
                rows.append((code(f"{name}({words})") + whose, (method.__doc__ or "").partition("\n")[0]))
    options = re.findall(r"^    - (``.+?``.*?): (.+(?:\n      .+)*)$", text, re.MULTILINE)
    rows += [(f"{name}, optional", " ".join(f"{said[0].upper()}{said[1:]}".split())) for name, said in options]
    return table(("name", "meaning"), ((name.replace("``", "`"), said.replace("``", "`")) for name, said in rows))


def losses() -> str:
    """Return the conditions on simulated losses of robots."""
    rows = ((code(each.name), each.form, each.reason) for each in THRESHOLDS)
    return table(("condition", "holds if", "reason"), rows)


def modules() -> str:
    """Return the modules for programs and notebooks, with the first line of their documentation."""
    rows = ((code(name), (ast.get_docstring(ast.parse(_source(name))) or "").splitlines()[0]) for name in PUBLIC)
    return table(("module", "content"), rows)


def _source(name: str) -> str:
    found = find_spec(name)
    if found is None or found.origin is None:
        raise ValueError(f"no module {name}")
    return Path(found.origin).read_text(encoding="utf-8")


@cache
def manifests() -> dict[str, ET.Element]:
    """Return the manifests of the packages in `src` by name."""
    paths = sorted(SOURCES.glob("*/package.xml"))
    return {path.parent.name: ET.parse(path).getroot() for path in paths}  # noqa: S314 - the project's own


def packages() -> dict[str, str]:
    """Return the descriptions of the packages in `src` from package.xml, by name."""
    return {name: root.findtext("description", "") for name, root in manifests().items()}


def imported(path: Path) -> set[str]:
    """Return the top-level modules that a file imports, including those for type checkers only."""
    modules: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            modules.add(node.module.partition(".")[0])
    return modules


@cache
def imports() -> dict[str, set[str]]:
    """Return the packages of the project that each package imports."""
    names = packages().keys()
    found = {
        name: set[str]().union(*(imported(path) for path in (SOURCES / name).rglob("*.py") if path.name != "setup.py"))
        for name in names
    }
    return {name: (modules & names) - {name} for name, modules in found.items()}


def needs() -> dict[str, set[str]]:
    """Return the packages of the project that each package needs at run time, by import or by name."""
    found = {
        name: {str(entry.text) for entry in root.iter("exec_depend")} & manifests().keys()
        for name, root in manifests().items()
    }
    return {name: found[name] | others for name, others in imports().items()}


def layers(arrows: dict[str, set[str]]) -> list[list[str]]:
    """Return the packages in layers from the top down: each is above all packages that it imports.

    Raises
    ------
    ValueError
        If packages import each other cyclically.
    """
    found: list[list[str]] = []
    below: set[str] = set()
    while len(below) < len(arrows):
        layer = sorted(name for name, needed in arrows.items() if name not in below and needed <= below)
        if not layer:
            raise ValueError(f"cyclic imports among {', '.join(sorted(arrows.keys() - below))}")
        found.insert(0, layer)
        below.update(layer)
    return found


def direct(arrows: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the transitive reduction of the arrows."""
    reached: dict[str, set[str]] = {}
    for name in (name for layer in reversed(layers(arrows)) for name in layer):
        reached[name] = arrows[name].union(*(reached[other] for other in arrows[name]))
    return {name: {to for to in tos if not any(to in reached[other] for other in tos)} for name, tos in arrows.items()}


def drawing() -> str:
    """Return the packages as a Mermaid graph without implied arrows; dashed arrows are not imports."""
    imported_by, arrows = imports(), needs()
    shown = direct(arrows)
    lines = ["graph TD"]
    for name in (name for layer in layers(arrows) for name in layer):
        lines += [f"    {name} {'-->' if to in imported_by[name] else '-.->'} {to}" for to in sorted(shown[name])]
    return "```mermaid\n" + "".join(f"{line}\n" for line in lines) + "```\n"


def package_table() -> str:
    """Return the table of the packages from the top down, with their descriptions."""
    said = packages()
    names = [name for layer in layers(needs()) for name in layer]
    return table(("package", "content"), ((code(name), said[name].rstrip(".")) for name in names))


def all_tables() -> dict[str, str]:
    """Return all tables by name."""
    return {
        "packages": package_table(),
        "structure": drawing(),
        **{f"commands {section}": commands(section) for section in SECTIONS},
        "modules": modules(),
        "topics": topics(),
        "message fields": message_fields(),
        "events": events(),
        "event codes": event_codes(),
        "scenario": fields(leaves(PlaneScenario)),
        "system scenario": fields(each for each in leaves(SystemScenario) if each not in {*leaves(PlaneScenario)}),
        "system robots": fields(leaves(SystemAgent)),
        "robots": variants(AGENT_KINDS, "kind"),
        "controllers": variants({name: CONTROLLER_CONFIGS[name] for name in CONTROLLERS.built_in}, "type"),
        "trajectories": variants(TRAJECTORY_CONFIGS, "type"),
        "observers": variants(OBSERVERS, "type"),
        "faults": variants(FAULT_KINDS, "kind"),
        "common": parameters((LockstepSettings,)),
        "plane_sim": parameters(plane_sim.node.PARAMETERS, without=COMMON),
        "plane_driver": parameters(plane_sim.driver.PARAMETERS, without=REALTIME_COMMON),
        "topic drive": parameters((TopicSettings,)),
        "abstraction_observer": parameters(abstraction_observer.node.PARAMETERS, without=COMMON),
        "parent_controller": parameters(parent_controller.node.PARAMETERS, without=COMMON),
        "controller parameters": controller_parameters(),
        "agent_node": parameters(agent_node.node.PARAMETERS, without=COMMON),
        "agent_group": parameters(agent_node.group.PARAMETERS),
        "parent system": parent_system(),
        "losses": losses(),
        "recorder": parameters(recorder.PARAMETERS),
        "steering": parameters(steering.PARAMETERS),
        "realtime common": parameters((RealtimeSettings,)),
        "realtime plane_sim": parameters(plane_sim.realtime.PARAMETERS, without=REALTIME_COMMON),
        "realtime abstraction_observer": parameters(abstraction_observer.realtime.PARAMETERS, without=REALTIME_COMMON),
        "realtime parent_controller": parameters(parent_controller.realtime.PARAMETERS, without=REALTIME_COMMON),
        "realtime agent_node": parameters(agent_node.realtime.PARAMETERS, without=REALTIME_COMMON),
        "realtime recorder": parameters(realtime_recorder.PARAMETERS),
        "realtime qos": realtime_qos(),
    }


def renewed(text: str, tables: dict[str, str]) -> str:
    """Return a page with updated tables."""
    return _TABLE.sub(lambda found: f"{found[1]}{tables[found[2]]}{found[3]}", text)


def view_schema() -> str:
    """Return the JSON Schema of the view's messages as text."""
    return json.dumps(json_schema(), indent=2, sort_keys=True) + "\n"


def main() -> int:
    """Update the tables of all pages, and the schema."""
    VIEW_SCHEMA.write_text(view_schema(), encoding="utf-8")
    tables = all_tables()
    for page in sorted(DOCS.glob("*/*.md")):
        text = page.read_text(encoding="utf-8")
        new = renewed(text, tables)
        if new != text:
            page.write_text(new, encoding="utf-8")
            sys.stderr.write(f"{page}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
