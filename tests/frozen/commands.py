"""Command lines with their exit codes and the shapes of the documents that ``--json`` prints."""

import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

from tests.frozen.command import CLI_MODULE, DATA, LONGEST, ROOT, Finished, frozen, swarm, swarm_process

CASES = frozen("commands")
"""By name: words, exit code, the run that must be there (during), and what comes out.

That is the shape of the document that is printed, or the document itself (values), or hashes of tables (tables).
"""

MAPS = {"versions", "environment", "values", "topics", "types"}
"""Fields whose keys are data; keys that are numbers are data everywhere."""

UNSTABLE = {"library", "wall_time", "setup_time", "start_time", "real_time_factor"}
"""Fields whose values differ from run to run, or from version to version."""

DURING = {
    "steered": ("pd_het_4", "--steer", "--rate", "1", "--duration", "600"),
    "realtime": ("pd_het_4", "--realtime", "--duration", "600"),
}
REFUSED = 2
ASKED_AGAIN = {"status"}
"""Cases that end with 1 for as long as a busy machine lets a robot halt: asked until all is in order."""
STARTING = {name for name, case in CASES.items() if case.get("over_dds") or name in {"sweep", "sweep_two"}}
"""The cases that start processes."""
SWEEP = "schema: 1\nscenario: pd_het_4\nset: {duration: 0.2}\ngrid: {plane.angle: [0.05, 0.1]}\n"


def shape(value: object, name: str = "") -> Any:
    """Return keys and types of a document: `float|null` is one or the other, a list holds the shape of its items."""
    if isinstance(value, dict):
        if name in MAPS or (value and all(key.isdigit() for key in value)):
            return {"*": merged([shape(each) for each in value.values()])}
        return {key: shape(each, key) for key, each in value.items()}
    if isinstance(value, list):
        return [merged([shape(each, name) for each in value])]
    names = {bool: "bool", int: "number", float: "number", str: "text", type(None): "null"}
    return names[type(value)]


def merged(shapes: list[Any]) -> Any:
    """Return one shape for all that are given; a key that is not always there ends with `?`."""
    if not shapes:
        return "nothing"
    if all(isinstance(each, dict) for each in shapes):
        keys = {key.rstrip("?"): None for each in shapes for key in each}
        found = {}
        for key in keys:
            having = [each.get(key, each.get(f"{key}?")) for each in shapes if key in each or f"{key}?" in each]
            always = all(key in each for each in shapes)
            found[key if always else f"{key}?"] = merged(having)
        return found
    if all(isinstance(each, list) for each in shapes):
        inner = [each[0] for each in shapes if each[0] != "nothing"]
        return [merged(inner)]
    flat = {part for each in shapes for part in (each.split("|") if isinstance(each, str) else ["structure"])}
    structures = [each for each in shapes if not isinstance(each, str)]
    return {"or": sorted(flat), "structure": merged(structures)} if structures else "|".join(sorted(flat))


def values(value: object, folder: Path) -> Any:
    """Return a document without what may change: paths of this machine, prose, and how a package is called."""
    if isinstance(value, dict):
        return {key: values(each, folder) for key, each in value.items() if key not in UNSTABLE}
    if isinstance(value, list):
        return [values(each, folder) for each in value]
    if isinstance(value, str):
        text = value.replace(str(DATA), "DATA").replace(str(folder), "FOLDER")
        return "text" if " " in text else text
    return value


def tables(folder: Path) -> dict[str, str]:
    """Return hashes of the tables that a command has written into a folder."""
    paths = (path for path in sorted(folder.glob("*.csv")) if path.name != "columns.csv")  # which is prose
    return {path.name: sha256(path.read_bytes()).hexdigest() for path in paths}


def outcome(name: str, done: Finished, folder: Path) -> dict[str, Any]:
    """Return the exit code of a case, and what comes out."""
    case, found = CASES[name], dict[str, Any](code=done.code)
    if case.get("of") == "tables":
        return {**found, "tables": tables(folder / "out" / name)}
    if "--json" not in case["words"] or not done.out or case.get("of") == "code":
        return found
    if case.get("of") == "values":
        return {**found, "document": values(done.document(), folder)}
    return {**found, "shape": shape(done.document())}


def fits(found: Any, wanted: Any, where: str = "") -> list[str]:
    """Return what is wanted and not found; keys that are new are no difference."""
    if isinstance(wanted, dict) and isinstance(found, dict):
        missing = [f"{where}.{key} is missing" for key in wanted if key not in found]
        return missing + [
            line for key in wanted if key in found for line in fits(found[key], wanted[key], f"{where}.{key}")
        ]
    if isinstance(wanted, list) and isinstance(found, list) and len(wanted) == len(found):
        pairs = enumerate(zip(found, wanted, strict=True))
        return [line for number, (have, want) in pairs for line in fits(have, want, f"{where}[{number}]")]
    return [] if found == wanted else [f"{where}: {wanted} was frozen, {found} is found"]


def prepare(folder: Path) -> dict[str, str]:
    """Make what the command lines work on; return the paths by the names they have there."""
    files = {
        "sweep": ("sweep.yaml", SWEEP),
        "unknown_key": ("unknown_key.yaml", "schema: 1\nplain: {}\nswarm: {generate: {single_integrator: 3}}\n"),
        "no_yaml": ("no.yaml", "a: [1\n"),
        "text": ("text.mcap", "this is no bag\n"),
    }
    for name, text in files.values():
        (folder / name).write_text(text, encoding="utf-8")
    for name, angle in (("run", 0.1), ("other", 0.09)):
        words = ("simulate", "pd_het_4", "--duration", 0.3, "--set", f"plane.angle={angle}", "-o", name)
        assert swarm(words, folder).code == 0
    shutil.copytree(folder / "run", folder / "damaged")
    bag = folder / "damaged" / "bag" / "bag_0.mcap"
    bag.write_bytes(bag.read_bytes()[:-2000])
    return {
        **{name: str(folder / file) for name, (file, _) in files.items()},
        **{name: str(folder / name) for name in ("run", "other", "damaged")},
        "data": str(DATA),
        "realtime": str(DATA / "realtime_1"),
        "fleet": str(ROOT / "examples" / "fleet" / "lan.yaml"),
        "away": str(folder / "nothing_is_here"),
    }


@contextmanager
def going_on(kind: str, folder: Path) -> Iterator[str]:
    """Start a run that goes on; yield its folder."""
    run = folder / kind
    words = [sys.executable, "-m", CLI_MODULE, "run", *DURING[kind], "-o", str(run)]
    asked = ("steer", run, "status") if kind == "steered" else ("status", run)
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            deadline = time.monotonic() + LONGEST
            while swarm_process(asked, folder).code != 0:
                assert process.poll() is None, f"the run has ended with {process.returncode}"
                assert time.monotonic() < deadline, "the run does not start"
            yield str(run)
        finally:
            process.send_signal(signal.SIGINT)


def run_case(name: str, folder: Path, names: dict[str, str]) -> Finished:
    """Run the command line of a case: as a process if it starts some itself, or talks to those of a run."""
    out = folder / "out" / name
    out.parent.mkdir(exist_ok=True)
    words = [word.format(**names, out=out) for word in CASES[name]["words"]]
    run = swarm_process if name in STARTING or "during" in CASES[name] else swarm
    done, deadline = run(words, folder), time.monotonic() + LONGEST
    while name in ASKED_AGAIN and done.code == 1 and time.monotonic() < deadline:
        assert done.document()["in_order"] is False, done.err
        done = run(words, folder)
    return done
