"""Short runs of the paper's scenarios, and what an independent reader finds in their bags."""

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from numpy.typing import NDArray

from swarmabs_analysis.figures import FIGURES
from swarmabs_bag.run_folder import new_run_folder
from swarmabs_config.scenarios import find_scenario
from swarmabs_run.simulated_run import simulate_run

NAMES = tuple(name for figure in FIGURES.values() for name in figure.scenarios)


def record(folder: Path, name: str, *overrides: str) -> Path:
    """Simulate a built-in scenario, by default for 0.3 s, and return the folder of its run."""
    run = new_run_folder(folder)
    outcome = simulate_run(find_scenario(name, ["duration=0.3", *overrides]).resolved(), run)
    assert outcome.status == "ok"
    return folder


@pytest.fixture(scope="session")
def short_runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a short run of each of the paper's scenarios, under its name; not to be changed."""
    folder = tmp_path_factory.mktemp("runs")
    for name in NAMES:
        record(folder / name, name)
    return folder


class ReadBag:
    """The messages of a bag by topic, read with the libraries of MCAP and nothing of this project."""

    def __init__(self, run: Path) -> None:
        self._messages: dict[str, list[Any]] = defaultdict(list)
        with (run / "bag" / "bag_0.mcap").open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            for _, channel, _, message in reader.iter_decoded_messages():
                self._messages[channel.topic].append(message)

    def column(self, topic: str, field: str, agent: int | None = None) -> NDArray[np.float64]:
        """Return a field in the order of the steps, of one robot if it is told."""
        messages = [m for m in self._messages[topic] if agent is None or m.agent_id == agent]
        return np.array([getattr(m, field) for m in sorted(messages, key=lambda m: m.step)])

    @property
    def count(self) -> int:
        return sum(map(len, self._messages.values()))

    def times(self) -> NDArray[np.float64]:
        """Return the times of the steps, s."""
        stamps = [m.header.stamp for m in sorted(self._messages["/plane/state"], key=lambda m: m.step)]
        return np.array([stamp.sec + stamp.nanosec * 1e-9 for stamp in stamps])

    def agents(self) -> list[int]:
        return sorted({m.agent_id for m in self._messages["/swarm/agent_state"]})
