"""The law of docs/extending.md does what the page says."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.docs.pages import blocks, read, section
from tests.plugin_packages import install

from swarmabs_config.scenario import parse_scenario
from swarmabs_core.swarm_law import LAWS
from swarmabs_run.simulation import simulate

PAGE = "docs/extending.md"


@pytest.mark.parametrize("kinds", ["single_integrator: 3", "double_integrator: 3, single_integrator: 4"])
def test_the_law_of_the_page_bounds_the_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kinds: str) -> None:
    text = section(read(PAGE), "A swarm law")
    (source,) = blocks(text, "python")
    (selection,) = blocks(text, "yaml")
    install(tmp_path, "law", "bounded", source, target="test_bounded:BOUNDED")
    monkeypatch.syspath_prepend(tmp_path)
    for cache in ("_loaded", "_packages"):
        monkeypatch.setattr(LAWS, cache, {})
    scenario = f"schema: 1\nduration: 10\nplane: {{angle: 0.3}}\n{selection}  generate: {{{kinds}}}\n"
    bounded = simulate(parse_scenario(scenario, overrides=["swarm.law.bound=0.2"]))
    paper = simulate(parse_scenario(scenario, overrides=["swarm.law.type=paper"]))
    assert abs(bounded.agents.command).max() <= 0.2 < abs(paper.agents.command).max()
    assert abs(bounded.angle[-1]) < 0.01
