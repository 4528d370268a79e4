"""One run of a soak: watched in every step, recorded, repeated, verified."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.soak.invariants import Invariant, Violation, lockstep_invariants

from swarmabs_analysis.verify import BagToVerify
from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.recording import Digest, RecordedStep
from swarmabs_config.scenario import Scenario
from swarmabs_core.errors import RunError
from swarmabs_run.simulation import Simulation

MOST_VIOLATIONS = 20
"""More of them say nothing new about a run."""

Steps = Callable[[], Iterator[RecordedStep]]


def lockstep_violations(scenario: Scenario, steps: Steps | None = None) -> list[Violation]:
    """Run a scenario in lockstep and return what does not hold; its bag is verified too."""
    steps = steps or (lambda: Simulation(scenario).steps())
    with TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        recording = Recording(scenario, bag, driver="simulate")
        found = violations(steps, lockstep_invariants(scenario), recording.add)
        if found:
            recording.abort("an invariant does not hold")
            return found
        digest = str(recording.close()["digest"])
        return [*_unverified(bag, digest), *not_repeated(steps, digest)]


def violations(
    steps: Steps, invariants: Sequence[Invariant], record: Callable[[RecordedStep], None] = lambda _: None
) -> list[Violation]:
    """Watch a run, and return what does not hold in it."""
    found: list[Violation] = []
    try:
        for step in steps():
            record(step)
            for invariant in invariants:
                found.extend(invariant.check(step))
            if len(found) > MOST_VIOLATIONS:
                return found
    except RunError as error:
        return [*found, Violation("run", None, None, str(error))]
    for invariant in invariants:
        found.extend(invariant.finish())
    return found


def not_repeated(steps: Steps, digest: str) -> Iterator[Violation]:
    """Yield that a second run gives other messages than the first, if it does."""
    again = digest_of(steps)
    if again != digest:
        yield Violation("repetition", None, None, f"a second run has the digest {again}, and not {digest}")


def digest_of(steps: Steps) -> str:
    """Return the digest of a run."""
    digest = Digest()
    for step in steps():
        digest.update(step)
    return digest.hexdigest()


def _unverified(bag: Path, digest: str) -> Iterator[Violation]:
    """Yield what `verify` finds wrong with a bag."""
    verdict = BagToVerify(bag).verify()
    difference = verdict.difference
    if difference is not None:
        yield Violation("verification", difference.step, difference.agent, str(difference))
    elif not verdict.ok:
        yield Violation("verification", None, None, str(verdict.problem))
    elif verdict.digest != digest:
        yield Violation("verification", None, None, f"the bag has the digest {verdict.digest}, and not {digest}")
