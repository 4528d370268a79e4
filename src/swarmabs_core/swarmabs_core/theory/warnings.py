"""What a user should know of the theory before a run: few lines, one per matter."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from swarmabs_core.theory.report import Condition, Report

_SAID_BY_THE_SCENARIO = {"inertia swing", "k1"}
"""Conditions of which `Scenario.warnings` speaks already."""
_DECIDING = "ks, friction alone"
_FOLLOWING = {"ks, all terms at rest", "initial state"}
"""Conditions that cannot hold if the deciding one does not."""


def theory_warnings(report: Report) -> tuple[str, ...]:
    """Return one line for the theorem of the run if it does not cover it, and one for sampled time."""
    return tuple(_lines(report))


def _lines(report: Report) -> Iterator[str]:
    for theorem in report.theorems:
        if theorem.label.endswith("_sys"):
            failed = [condition for condition in theorem.failed if condition.name not in _SAID_BY_THE_SCENARIO]
            deciding = [condition for condition in failed if condition.name == _DECIDING]
            if deciding:
                failed = [condition for condition in failed if condition.name not in _FOLLOWING]
            if failed:
                told = "; ".join(_told(condition) for condition in failed)
                yield f"theorem {theorem.label} is not fulfilled: {told}; see the command check"
    late = [condition for condition in report.beyond.failed if condition.name not in _SAID_BY_THE_SCENARIO]
    if late:
        yield f"sampled time: {'; '.join(_told(condition) for condition in late)}; see the command check"


def _told(condition: Condition) -> str:
    if condition.name == _DECIDING:
        return condition.note
    form = condition.corrected
    return f"{condition.name}: {form.value:.4g} is not {form.relation} {form.bound:.4g}"
