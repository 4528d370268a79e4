"""Level an upper plane whose robots are moved by lower planes, each levelled by a swarm of its own, and record it all.

In a shell prepared by `eval "$(./scripts/swarm env)"`: python examples/cascade/cascade.py. What it shows, and how the
layers are coupled: docs/cascade.md.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from layers import CascadeSimulation, Coupling, load_cascade

from swarmabs_bringup.recorder.recording import Recording
from swarmabs_bringup.run_folder import RunFolder, new_run_folder, next_run_folder
from swarmabs_bringup.summary import summarise
from swarmabs_core.errors import InputError, RunError

if TYPE_CHECKING:
    from layers import CascadeScenario

COUPLING_FILE = "coupling.json"
"""Attachment of every bag: how its layer is coupled to the others."""


def simulate_cascade(cascade: CascadeScenario, folder: RunFolder) -> dict[str, dict[str, object]]:
    """Simulate a cascade and record it: in the folder, every layer has a folder like that of a run.

    Parameters
    ----------
    cascade : CascadeScenario
        What to simulate.
    folder : RunFolder
        An empty folder.

    Returns
    -------
    dict
        The summary of every layer by its namespace.

    Raises
    ------
    RunError
        If the run fails; the bags are then completed as far as they go.
    """
    begun = time.monotonic()
    folders = {name: new_run_folder(folder.path / name.strip("/")) for name in cascade.layers}
    recordings = {}
    for name, scenario in cascade.layers.items():
        folders[name].fill(scenario)
        recordings[name] = Recording(scenario, folders[name].bag, driver="examples/cascade", namespace=name)
    attachments = {COUPLING_FILE: json.dumps(asdict(cascade.coupling)).encode() + b"\n"}
    reason: RunError | None = None
    try:
        for name, step in CascadeSimulation(cascade).steps():
            recordings[name].add(step)
    except RunError as error:
        reason = error
    summaries = {}
    for name, recording in recordings.items():
        figures = recording.abort(str(reason), attachments) if reason else recording.close(attachments)
        seconds = time.monotonic() - begun
        summaries[name] = summarise(
            cascade.layers[name],
            figures,
            status="failed" if reason else "ok",
            reason=str(reason) if reason else None,
            wall_time=seconds,
            stepping_seconds=seconds,
        )
        folders[name].write_summary(summaries[name])
    if reason:
        raise reason
    return summaries


def main(arguments: list[str]) -> int:
    """Run the example; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "-o", "--output", metavar="DIR", type=Path, help="folder of the results; default: runs/cascade-NNN"
    )
    parser.add_argument("--bandwidth", type=float, default=Coupling().bandwidth, help="of the lower references, rad/s")
    parser.add_argument("--set", action="append", default=[], metavar="A.B=VALUE", help="change a value in all layers")
    asked = parser.parse_args(arguments)
    try:
        cascade = load_cascade(Coupling(bandwidth=asked.bandwidth), asked.set)
        folder = new_run_folder(asked.output) if asked.output else next_run_folder(Path("runs"), "cascade")
        summaries = simulate_cascade(cascade, folder)
    except (InputError, RunError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 2 if isinstance(error, InputError) else 1
    for name, summary in summaries.items():
        print(f"{name:<9} level within 0.01 rad from {summary['settled_at']} s on, digest {summary['digest']}")
    print(f"bags: {folder.path}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
