"""Bad input: exit code 2, one line on standard error that names file, field and remedy, and nothing left behind."""

from pathlib import Path

import pytest
from tests.privileges import respecting_permissions
from tests.swarmabs_cli.conftest import refused

GOOD = "schema: 1\nduration: 0.1\nswarm: {generate: {single_integrator: 2}}\n"


@pytest.fixture
def folder(here: Path) -> Path:
    """Return the working directory, with a good scenario, a bad one and a folder that is in use."""
    (here / "good.yaml").write_text(GOOD)
    (here / "bad.yaml").write_text(f"{GOOD}plne: {{angle: 0.1}}\n")
    (here / "used").mkdir()
    (here / "used" / "precious").write_text("x")
    return here


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["bad.yaml"], ("bad.yaml:4", "plne", "did you mean 'plane'?")),
        (["missing.yaml"], ("missing.yaml",)),
        (["pd_het4"], ("pd_het4", "did you mean pd_het_4?")),
        (["good.yaml", "-o", "used"], ("used", "not empty", "-o")),
        (["good.yaml", "-o", "good.yaml"], ("good.yaml", "not a folder", "-o")),
        (["good.yaml", "-o", "good.yaml/sub"], ("not a folder", "-o")),
        (["good.yaml", "-o", "/proc/nowhere"], ("/proc/nowhere", "-o")),
        (["good.yaml", "--set", "plane.anlge=1"], ("plane.anlge", "angle")),
        (["good.yaml", "--set", "plane.angle"], ("plane.angle", "=")),
        (["good.yaml", "--duration", "0.015"], ("duration", "step")),
        (["good.yaml", "--duration", "soon"], ("duration", "soon")),
        *(
            (["good.yaml", "--max-bag-duration", text], ("--max-bag-duration", "whole number of seconds", f"'{text}'"))
            for text in ("0.5", "-1", "1000000001", "soon", "nan")
        ),
        (["good.yaml", "--max-bag-size", "1e6"], ("--max-bag-size", "whole number of bytes", "'1e6'")),
        (["good.yaml", "--max-bag-size", str(2**63)], ("--max-bag-size", f"1 to {2**63 - 1}")),
        (["used"], ("used",)),
        (["used/precious.mcap"], ("precious.mcap",)),
        (["good.yaml", "--durations", "1"], ("--durations",)),
        (["good.yaml", "other.yaml"], ("other.yaml",)),
    ],
)
def test_bad_words(words: list[str], named: tuple[str, ...], folder: Path) -> None:
    for command in ("run", "simulate"):
        error = refused(command, *words, *([] if "-o" in words else ["-o", "out"]))
        assert [word for word in named if word not in error] == [], error


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["fly"], "fly"),
        (["view"], "Name either a bag, or a running swarm with --live."),
        (["view", "x", "--live", "/"], "Name either a bag, or a running swarm with --live."),
        (["view", "/nowhere"], "/nowhere"),
        (["view", "--live", "no such thing"], "neither a run folder nor a namespace"),
        (["view", "--live", "/", "--namespace", "/x"], "name the namespace with --live"),
        (["check", "nothing", "--strict", "--json"], "nothing"),
        (["check", "pd_si_4", "--set", "plane.angel=1", "--strict", "--json"], "angel"),
        (["check", "pd_si_4", "--angle-max", "2", "--strict", "--json"], "--angle-max"),
        (["report", "missing"], "missing"),
        (["report", "used"], "used"),
        (["report", "good.yaml"], "good.yaml"),
        (["replay", "used"], "contains no bag"),
        (["markers", "{run}", "-o", "used"], "exists; name another"),
        (["markers", "missing", "-o", "new"], "missing"),
        (["replay", "used", "--node", "plane"], "contains no bag"),
        (["info"], "BAG"),
        (["info", "used"], "used"),
        (["info", "missing"], "missing"),
        (["info", "good.yaml"], "good.yaml"),
        (["scenario", "show", "pd_het4"], "did you mean pd_het_4?"),
        (["scenario", "draw"], "draw"),
        (["env", "used"], "used"),
    ],
)
def test_other_commands_refuse_the_same_way(words: list[str], named: str, folder: Path, run: Path) -> None:
    assert named in refused(*(word.format(run=run) for word in words))


@pytest.mark.parametrize("command", ["run", "simulate"])
@pytest.mark.parametrize("folder", ["closed", "closed/sub"])
def test_a_folder_without_permission(command: str, folder: str, here: Path) -> None:
    (here / "closed").mkdir(mode=0o555)
    error = respecting_permissions(lambda: refused(command, "pd_het_4", "-o", folder))
    assert error.startswith(f"error: output folder {folder} cannot be ")
    assert error.endswith("choose another with -o\n")
