"""Level an upper plane whose robots are moved by lower planes, each levelled by its own swarm, and record all layers.

In a shell prepared by `eval "$(./scripts/swarm env)"`: python examples/cascade/cascade.py. The results and the coupling
of the layers are described in docs/explanation/cascade.md.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from layers import FOLDER, CascadeSimulation, Coupling, load_cascade
from processes import CascadeRun

from swarmabs_bag.recorder.recording import Recording
from swarmabs_bag.run_folder import RunFolder, new_run_folder, next_run_folder
from swarmabs_core.errors import InputError, RunError
from swarmabs_run.run import Outcome
from swarmabs_run.summary import Times, summarise

if TYPE_CHECKING:
    from layers import CascadeScenario

COUPLING_FILE = "coupling.json"
"""File with the coupling, in the folder of the cascade."""

Figures = Mapping[str, object]


class Layers:
    """The results of a cascade: a run folder for every layer.

    Parameters
    ----------
    cascade : CascadeScenario
        The cascade that is run.
    folder : RunFolder
        An empty folder.
    """

    def __init__(self, cascade: CascadeScenario, folder: RunFolder) -> None:
        self._cascade = cascade
        self.folders = {name: new_run_folder(folder.path / name.strip("/")) for name in cascade.layers}
        for name, scenario in cascade.layers.items():
            self.folders[name].fill(scenario)
        (folder.path / COUPLING_FILE).write_text(
            json.dumps(asdict(cascade.coupling), indent=2) + "\n", encoding="utf-8"
        )

    def summarise(
        self, figures: Mapping[str, Figures], begun: float, reason: str | None
    ) -> dict[str, dict[str, object]]:
        """Write and return the summary of every layer by its namespace."""
        summaries = {
            name: summarise(
                scenario,
                Outcome("failed" if reason else "ok", reason, dict(figures.get(name, {}))),
                Times(time.monotonic() - begun),
            )
            for name, scenario in self._cascade.layers.items()
        }
        for name, summary in summaries.items():
            self.folders[name].write_summary(summary)
        return summaries


def simulate_cascade(cascade: CascadeScenario, folder: RunFolder) -> dict[str, dict[str, object]]:
    """Simulate a cascade in this process, record it, and return the summary of every layer by its namespace.

    Raises
    ------
    RunError
        If the run fails or is interrupted; the bags are then completed as far as possible.
    """
    begun = time.monotonic()
    layers = Layers(cascade, folder)
    recordings = {
        name: Recording(scenario, layers.folders[name].bag, driver="simulate", namespace=name)
        for name, scenario in cascade.layers.items()
    }
    try:
        for name, step in CascadeSimulation(cascade).steps():
            recordings[name].add(step)
    except (RunError, KeyboardInterrupt) as error:
        reason = str(error) or "interrupted"
        layers.summarise({name: recording.abort(reason) for name, recording in recordings.items()}, begun, reason)
        raise RunError(reason) from error
    return layers.summarise({name: recording.close() for name, recording in recordings.items()}, begun, None)


def run_cascade(cascade: CascadeScenario, folder: RunFolder) -> dict[str, dict[str, object]]:
    """Run a cascade with a process per robot over DDS, and return the summary of every layer by its namespace.

    Raises
    ------
    RunError
        If the run fails or is interrupted; the bags are then completed as far as possible.
    """
    begun = time.monotonic()
    layers = Layers(cascade, folder)
    run = CascadeRun(cascade, layers.folders)
    try:
        run.run()
    except (RunError, KeyboardInterrupt) as error:
        reason = str(error) or "interrupted"
        layers.summarise(run.figures, begun, reason)
        raise RunError(reason) from error
    return layers.summarise(run.figures, begun, None)


def main(arguments: list[str]) -> int:
    """Run the example and return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "folder", nargs="?", type=Path, default=FOLDER, help="folder of the scenarios; default: that of this file"
    )
    parser.add_argument(
        "-o", "--output", metavar="DIR", type=Path, help="folder of the results; default: runs/cascade-NNN"
    )
    parser.add_argument("--ratio", type=float, default=Coupling().ratio, help="speed by tilt, m/(s rad)")
    parser.add_argument("--bandwidth", type=float, default=Coupling().bandwidth, help="of the lower references, rad/s")
    parser.add_argument("--set", action="append", default=[], metavar="A.B=VALUE", help="change a value in all layers")
    parser.add_argument("--processes", action="store_true", help="a process for every robot and node, over DDS")
    asked = parser.parse_args(arguments)
    try:
        cascade = load_cascade(asked.folder, Coupling(asked.ratio, asked.bandwidth), asked.set)
        folder = new_run_folder(asked.output) if asked.output else next_run_folder(Path("runs"), "cascade")
        summaries = (run_cascade if asked.processes else simulate_cascade)(cascade, folder)
    except (InputError, RunError) as error:
        sys.stderr.write(f"error: {error}\n")
        return 2 if isinstance(error, InputError) else 1
    for name, summary in summaries.items():
        print(f"{name:<9} settled within 0.01 rad at {summary['settled_at']} s, digest {summary['digest']}")
    print(f"bags: {folder.path}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
