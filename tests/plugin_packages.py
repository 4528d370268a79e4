"""Installed packages that bring parts, made by tests: a module, and the metadata that an installer leaves beside it."""

from pathlib import Path
from textwrap import dedent

GROUPS = {
    "controller": "swarmabs.parent_controllers",
    "law": "swarmabs.swarm_laws",
    "drive": "swarmabs.drives",
    "system": "swarmabs.parent_systems",
}

BANG_BANG = """
    from math import copysign

    from swarmabs_core.controllers import ControllerType
    from swarmabs_core.parameters import Parameter


    class BangBang:
        def __init__(self, settings, context):
            self.torque_of = settings["torque"]

        def reference(self, time):
            return 0.0

        def torque(self, time, plane):
            return copysign(self.torque_of, plane.angle + plane.angular_velocity)


    SETTINGS = (
        Parameter("torque", 0.1, "torque, N m", above=0.0, maximum=2.0),
        Parameter("copy", 3, "a name that pydantic's models have", minimum=1),
        Parameter("mode", "hard", "a choice", choices=("hard", "soft")),
        Parameter("label", "x", "a text"),
        Parameter("on", default=True, description="a flag"),
        Parameter("pair", (1.0, 2.0), "two numbers", minimum=0.0, length=2),
        Parameter("many", (1, 2, 3), "numbers"),
        Parameter("words", (), "texts"),
        Parameter("inner.a", 0.5, "a nested number"),
        Parameter("inner.deep.b", 1.5, "a number nested more deeply"),
    )
    PART = ControllerType("bang_bang", SETTINGS, BangBang)
"""

SCALED = """
    from dataclasses import replace
    from math import nan

    from swarmabs_core.swarm_law import PAPER, SwarmLaw
    from swarmabs_core.parameters import Parameter


    def make(settings, robot):
        factor, bad_mass = settings["factor"], settings["bad_mass"]
        gains = robot.gains
        scaled = [tuple(factor * each for each in getattr(gains, name)) for name in ("k", "kp", "kd")]
        paper = PAPER.make({}, replace(robot, gains=replace(gains, **dict(zip(("k", "kp", "kd"), scaled)))))

        def command(position, velocity, abstract, sums, desired):
            if robot.mass == bad_mass and abstract.step >= 5:
                return nan
            return paper(position, velocity, abstract, sums, desired)

        return command


    PART = SwarmLaw(
        "scaled",
        (
            Parameter("factor", 1.0, "by what the gains are multiplied", above=0.0),
            Parameter("bad_mass", 0.0, "mass in kg of robots whose law fails from step 5 on"),
        ),
        make,
    )
"""


def install(
    folder: Path, kind: str, name: str, source: str, *, package: str | None = None, target: str | None = None
) -> None:
    """Install a package with one module, and with an entry point to `PART` in it, into a folder of the search path."""
    package = package or f"test-{name.replace('_', '-')}"
    module = package.replace("-", "_")
    folder.mkdir(exist_ok=True)
    (folder / f"{module}.py").write_text(dedent(source), encoding="utf-8")
    metadata = folder / f"{module}-1.5.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.5\n", encoding="utf-8")
    points = f"[{GROUPS[kind]}]\n{name} = {target or f'{module}:PART'}\n"
    (metadata / "entry_points.txt").write_text(points, encoding="utf-8")
