"""The written report of a soak: ``soak.json`` for programs, ``soak.md`` for people."""

from __future__ import annotations

import json
from collections import Counter
from typing import TYPE_CHECKING, Any

from swarmabs_analysis.soak.invariants import RECOVERED_BELOW, RECOVERY_BOUND
from swarmabs_bag.provenance import versions

if TYPE_CHECKING:
    from pathlib import Path

    from swarmabs_analysis.soak.run import Soak
    from swarmabs_analysis.soak.trial import Trial

SCHEMA_VERSION = 1


def to_dict(soak: Soak, wall_time: float) -> dict[str, Any]:
    """Return a soak as plain data for JSON."""
    extent = soak.extent
    return {
        "schema": SCHEMA_VERSION,
        "status": soak.status,
        "engine": soak.engine,
        "seed": extent.seed,
        "robots": extent.robots,
        "first": extent.first,
        "runs": extent.runs,
        "finished": len(soak.trials),
        "simulated_hours": sum(trial.seconds for trial in soak.trials) / 3600.0,
        "wall_time": wall_time,
        "failures": [
            {"number": trial.number, "command": extent.command(trial.number), "folder": _folder(trial)}
            for trial in soak.failed
        ],
        "recovery_bound": RECOVERY_BOUND,
        "longest_recovery": max(_seen([trial.to_dict() for trial in soak.trials], "recovery"), default=None),
        "growth": [one._asdict() | {"ok": one.ok} for one in soak.growth],
        "trials": [trial.to_dict() for trial in soak.trials],
        "versions": versions(),
    }


def write_report(document: dict[str, Any], folder: Path) -> None:
    """Write both files of a report."""
    (folder / "soak.json").write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    (folder / "soak.md").write_text(markdown(document), encoding="utf-8")


def _folder(trial: Trial) -> str:
    return f"run-{trial.number:05d}"


def markdown(document: dict[str, Any]) -> str:
    """Return the report for people."""
    trials: list[dict[str, Any]] = document["trials"]
    kinds = Counter(kind for trial in trials for kind in set(trial["faults"]))
    finished = (
        f"{document['finished']} of {document['runs']} runs from number {document['first']} on, "
        f"{document['simulated_hours']:.3g} h simulated in {document['wall_time'] / 60.0:.3g} min by the engine "
        f"`{document['engine']}`; {len(document['failures'])} failed."
    )
    recovery = f"{_quantiles(_seen(trials, 'recovery'))}; bound {document['recovery_bound']:g}"
    lines = [
        f"# Soak, seed {document['seed']}: {document['status']}",
        "",
        finished,
        "",
        "| what | figure |",
        "| --- | --- |",
        f"| steps | {sum(trial['steps'] + 1 for trial in trials):,} |",
        f"| robots in a run | {_range([trial['agents'] for trial in trials])} |",
        f"| runs with each fault | {', '.join(f'{kind} {n}' for kind, n in sorted(kinds.items())) or 'none'} |",
        f"| recovery to {RECOVERED_BELOW} rad after the last fault, s | {recovery} |",
        f"| oldest broadcasts acted on, steps | {max(_seen(trials, 'oldest_broadcasts'), default=0)} |",
        *_where(trials),
        "",
        "## Failures",
        "",
    ]
    if not document["failures"]:
        lines.append("None.")
    violations = {trial["number"]: trial["violations"] for trial in trials}
    for failure in document["failures"]:
        lines += [
            f"Run {failure['number']}, kept in `{failure['folder']}`; again by `{failure['command']}`:",
            "",
            *(f"- {_violation(violation)}" for violation in violations[failure["number"]]),
            "",
        ]
    lines += ["", "## Growth", "", "| of | early | late | allowed | |", "| --- | --- | --- | --- | --- |"]
    for one in document["growth"]:
        allowed = "too few runs to judge" if one["allowed"] is None else f"{one['allowed']:g}"
        verdict = "" if one["allowed"] is None else "ok" if one["ok"] else "GROWS"
        lines.append(f"| {one['what']} | {one['early']:g} | {one['late']:g} | {allowed} | {verdict} |")
    return "\n".join(lines) + "\n"


def _violation(violation: dict[str, Any]) -> str:
    where = "" if violation["step"] is None else f", step {violation['step']}"
    who = "" if violation["agent"] is None else f", robot {violation['agent']}"
    return f"{violation['invariant']}{where}{who}: {violation['text']}"


def _where(trials: list[dict[str, Any]]) -> list[str]:
    """Return the row that says how far robots have come."""
    farthest = _seen(trials, "farthest")
    if farthest:
        return [f"| farthest from the axis, m | {farthest[-1]:.4g} |"]
    return [f"| robots off the plane, each with an event | {sum(_seen(trials, 'crossings'))} |"]


def _seen(trials: list[dict[str, Any]], figure: str) -> list[float]:
    """Return a figure of all runs that have it, ascending."""
    found = (trial["figures"].get(figure) for trial in trials)
    return sorted(value for value in found if value is not None)


def _range(values: list[int]) -> str:
    return f"{min(values)} to {max(values)}" if values else "-"


def _quantiles(values: list[float]) -> str:
    if not values:
        return "-"
    return f"median {values[len(values) // 2]:.3g}, longest {values[-1]:.3g}"
