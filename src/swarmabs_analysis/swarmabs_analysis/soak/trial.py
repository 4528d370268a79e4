"""One run of a soak: watched, recorded, verified, repeated."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from swarmabs_analysis.soak.invariants import Violation
from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.recording import Digest
from swarmabs_core.errors import RunError, SwarmabsError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from swarmabs_analysis.soak.engine import Engine
    from swarmabs_bag.recording import RecordedStep
    from swarmabs_bag.run_folder import RunFolder
    from swarmabs_config.scenario import Scenario

MOST_VIOLATIONS = 20
"""More of them say nothing new about a run."""


class StoppedError(Exception):
    """An end was asked for."""


@dataclass(slots=True)
class Trial:
    """What came of a run.

    Attributes
    ----------
    number : int
        Its number in the soak.
    agents, steps : int
        Size of its scenario.
    seconds : float
        Simulated time, s.
    faults : list of str
        Kinds of its faults.
    digest : str or None
        Digest of its messages.
    figures : dict
        What the invariants have seen.
    violations : list of Violation
        What does not hold.
    """

    number: int
    agents: int
    steps: int
    seconds: float
    faults: list[str]
    digest: str | None = None
    figures: dict[str, float | None] = field(default_factory=dict)
    violations: list[Violation] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain data for JSON."""
        names = ("number", "agents", "steps", "seconds", "faults", "digest", "figures")
        return {name: getattr(self, name) for name in names} | {
            "violations": [violation._asdict() for violation in self.violations]
        }


def run_trial(number: int, scenario: Scenario, engine: Engine, folder: RunFolder, stop: Callable[[], bool]) -> Trial:
    """Run a scenario once with everything checked, then again, and verify the bag of the first run if that is possible.

    Parameters
    ----------
    number : int
        Number of the run.
    scenario : Scenario
        What is run; its robots are listed.
    engine : Engine
        What runs it.
    folder : RunFolder
        An empty folder for scenario and bag.
    stop : callable
        Tells whether an end was asked for.

    Raises
    ------
    StoppedError
        If it was.
    OSError, BagWriteError
        If the bag cannot be written.
    """
    faults = engine.kinds(scenario)
    trial = Trial(number, len(scenario.agents), scenario.steps, scenario.steps * scenario.period, faults)
    folder.fill(scenario)
    _watch(trial, scenario, engine, folder, stop)
    if trial.digest is not None:
        with suppress(RunError):  # the same as before, which is told already
            if (digest := _digest(scenario, engine, stop)) != trial.digest:
                trial.violations.append(Violation("repetition", None, None, f"a second run has the digest {digest}"))
        if engine.verifiable:
            _verify(trial, folder)
    return trial


def _watch(trial: Trial, scenario: Scenario, engine: Engine, folder: RunFolder, stop: Callable[[], bool]) -> None:
    """Run, check and record."""
    invariants = engine.invariants(scenario)
    recording = Recording(scenario, folder.bag, driver=engine.name, topics=engine.topics)
    found = trial.violations
    try:
        for step in _until(stop, engine.steps(scenario)):
            recording.add(step)
            for invariant in invariants:
                found.extend(invariant.check(step))
            if len(found) > MOST_VIOLATIONS:
                break
        else:
            for invariant in invariants:
                found.extend(invariant.finish())
    except RunError as error:
        found.append(Violation("run", None, None, str(error)))
        recording.abort(str(error))
    except BaseException:
        recording.abort("interrupted")
        raise
    else:
        if len(found) > MOST_VIOLATIONS:
            recording.abort("too many invariants do not hold")
        else:
            trial.digest = str(recording.close()["digest"])
    for invariant in invariants:
        trial.figures |= invariant.figures()


def _until(stop: Callable[[], bool], steps: Iterable[RecordedStep]) -> Iterator[RecordedStep]:
    """Yield steps until an end is asked for."""
    for step in steps:
        if stop():
            raise StoppedError
        yield step


def _digest(scenario: Scenario, engine: Engine, stop: Callable[[], bool]) -> str:
    digest = Digest()
    for step in _until(stop, engine.steps(scenario)):
        digest.update(step)
    return digest.hexdigest()


def _verify(trial: Trial, folder: RunFolder) -> None:
    """Verify the bag."""
    try:
        verdict = BagToVerify(folder.bag).verify()
    except SwarmabsError as error:
        trial.violations.append(Violation("verification", None, None, str(error)))
        return
    if not verdict.ok:
        step = verdict.difference.step if verdict.difference is not None else None
        agent = verdict.difference.agent if verdict.difference is not None else None
        text = str(verdict.difference or verdict.problem)
        trial.violations.append(Violation("verification", step, agent, text))
    elif verdict.digest != trial.digest:
        trial.violations.append(Violation("verification", None, None, f"the bag has the digest {verdict.digest}"))
