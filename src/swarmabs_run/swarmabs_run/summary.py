"""``summary.json``: the results of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from rich.text import Text

from swarmabs_bag.run.figures import PLANE_TRACKING
from swarmabs_core.ranges import texts_of

if TYPE_CHECKING:
    from swarmabs_bag.run.figures import Tracking
    from swarmabs_bag.run_folder import RunFolder
    from swarmabs_config.scenario import Scenario
    from swarmabs_run.run import Outcome

AGES_SHOWN = 3
"""Number of broadcast ages that the table lists individually."""
FIGURES = ("settled_at", "final_error", "rms_error", "max_abs_position", "messages", "digest")


Summary: TypeAlias = Mapping[str, Any]
"""The content of ``summary.json``, or of an object in it."""


@dataclass(frozen=True, slots=True)
class Times:
    """Durations, s: the whole command, the set-up of the checkout within it, and from there to the first step."""

    wall: float
    setup: float = 0.0
    startup: float | None = None


def summarise(scenario: Scenario, outcome: Outcome, times: Times) -> dict[str, object]:
    """Return the content of ``summary.json``; `swarmabs_analysis.rerun` adds ``rerun_of``."""
    figures, run = outcome.figures, outcome.stepping_seconds
    complete = outcome.status == "ok" and run
    return {
        "scenario": scenario.name,
        "steps": scenario.steps,
        "duration": scenario.duration_ns / 1e9,
        "wall_time": round(times.wall, 3),
        "setup_time": round(times.setup, 3),
        "startup_time": None if times.startup is None else round(times.startup, 3),
        "run_time": None if run is None else round(run, 3),
        "real_time_factor": round(scenario.duration_ns / 1e9 / run, 3) if complete and run else None,
        "agents": len(scenario.agents),
        **{name: figures.get(name) for name in FIGURES},
        "events": figures.get("events", []),
        **({"out_of_range": figures["out_of_range"]} if "out_of_range" in figures else {}),
        "status": outcome.status,
        "reason": outcome.reason,
        "rerun_of": None,
        **({"realtime": figures["realtime"]} if "realtime" in figures else {}),
        **({"packed": True} if outcome.packed else {}),
    }


def summary_table(summary: Summary, folder: RunFolder, tracking: Tracking = PLANE_TRACKING) -> Text:
    """Return the summary as lines for the terminal; `tracking` is what the parent tracks.

    Print it without wrapping, which would tear the digest, so that it could not be copied.
    """

    def row(key: str) -> dict[str, str]:
        value, (name, unit, *_) = summary[key], tracking.figures[key]
        return {name: "-" if value is None else f"{value:.4g} {unit}".rstrip()}

    within = f"within {', '.join(f'{tolerance:g}' for tolerance in dict.fromkeys(tracking.tolerances))} {tracking.unit}"
    settled = summary["settled_at"]
    rows = {
        "scenario": f"{summary['scenario']}, {summary['agents']} robots, {summary['steps']} steps",
        "status": summary["status"],
        "wall time": _wall_time(summary),
        "settled": f"not {within}" if settled is None else f"{within} from t = {settled:g} s",
        **row("final_error"),
        **row("rms_error"),
        **row("max_abs_position"),
        "messages": str(summary["messages"] or 0),
        "digest": summary["digest"] or "-",
        "folder": str(folder.path),
    }
    if not tracking.tolerances:  # nothing follows a reference
        rows = {name: text for name, text in rows.items() if name not in {"settled", "final error", "rms error"}}
    if "realtime" in summary:
        del rows["digest"]  # it depends on timing
        rows |= _realtime_rows(summary["realtime"])
    if summary.get("packed"):
        rows["packed"] = "broadcasts, and states for plane and recorder (--no-packed: one message each)"
    if "out_of_range" in summary:
        rows["out of range"] = "\n".join(texts_of(summary["out_of_range"]))
    if summary["events"]:
        rows["events"] = "\n".join(summary["events"])
    if summary["rerun_of"] is not None:
        rows["rerun of"] = _rerun(summary["rerun_of"])
    if (folder.bag / "metadata.yaml").exists():
        rows["bag"] = str(folder.bag)
    width = max(map(len, rows)) + 2
    lines = [
        Text.assemble((f"{'' if number else name:<{width}}", "dim"), line)
        for name, value in rows.items()
        for number, line in enumerate(str(value).split("\n"))
    ]
    return Text("\n").join(lines)


def _wall_time(summary: Summary) -> str:
    """Return the duration of the command without the set-up of the checkout, and of its parts as far as known."""
    parts = {"start": summary["startup_time"], "run": summary["run_time"]}
    durations = [f"{name} {seconds:.1f} s" for name, seconds in parts.items() if seconds is not None]
    if summary["real_time_factor"]:
        durations.append(f"{summary['real_time_factor']:.1f} x real time")
    return f"{summary['wall_time'] - summary['setup_time']:.1f} s" + (f": {', '.join(durations)}" if durations else "")


def _realtime_rows(realtime: Summary) -> dict[str, str]:
    """Return the rows that apply only to a run in real time."""
    missed, longest = realtime.get("missed_periods", {}), realtime.get("longest_us", {})
    losses, ages = realtime.get("losses", {}), realtime.get("broadcast_ages", {})
    missing = {topic: loss["missing"] for topic, loss in losses.items() if loss["missing"]}
    rows = {
        "missed periods": ", ".join(f"{name} {n}" for name, n in missed.items() if n) or "none",
        "latest step": f"{max(longest.values()) / 1000:.1f} ms late" if longest else "-",
        "missing messages": ", ".join(f"{topic} {n}" for topic, n in missing.items()) or "none",
        "broadcasts used": _ages(ages),
        "safe stops": str(realtime.get("safe_stops", 0)),
    }
    if realtime.get("died"):
        rows["died"] = ", ".join(f"{name} {how}" for name, how in realtime["died"].items())
    return rows


def _ages(ages: Mapping[str, int]) -> str:
    """Return the number of broadcasts used at each age in steps; ages beyond the first few are summed."""
    counts = [(int(age), count) for age, count in ages.items()]
    shown = [f"{count} after {age} steps" for age, count in counts[:AGES_SHOWN]]
    if rest := counts[AGES_SHOWN:]:
        shown.append(f"{sum(count for _, count in rest)} after up to {max(age for age, _ in rest)} steps")
    return ", ".join(shown) or "none"


def _rerun(rerun: Summary) -> str:
    result = {True: "same digest", False: "different digest", None: "digests not comparable"}[rerun["same"]]
    if rerun["same"] and rerun["compared"] == "prefix":
        result = f"same digest up to its last step, {rerun['last_step']}"
    return f"{rerun['bag']}: {result}"
