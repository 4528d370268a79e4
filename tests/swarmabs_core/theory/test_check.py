"""Which theorems are about a scenario, and which of their conditions fail; `tests/errata` proves single numbers."""

import json
from functools import cache
from pathlib import Path

import pytest
from tests.swarmabs_core.helpers import builtin

from swarmabs_config.theory import check_scenario, setting
from swarmabs_core.theory.check import warnings
from swarmabs_core.theory.report import Report, Verdict

ALL = ("pd_si_4", "pd_di_4", "pd_het_4", "arise_si_4", "arise_di_4", "arise_het_4", "arise_het_20", "arise_het_200")
FROZEN = Path(__file__).with_name("reports.json")
KINDS = {"si": "SI", "di": "DI", "het": "noHomo"}


@cache
def check(name: str, *overrides: str) -> Report:
    return check_scenario(builtin(name, *overrides))


@pytest.mark.parametrize("name", ALL)
def test_one_of_the_six_theorems_is_about_each_run_and_covers_those_with_pd(name: str) -> None:
    report = check(name)
    controller, kind, _ = name.split("_")
    label = f"{'LQR' if controller == 'pd' else 'ARISE'}_{KINDS[kind]}_sys"
    applicable = [one for one in report.theorems if one.applicable]
    assert [one.label for one in applicable] == [label, "GeneralStability", "GeneralConstrainedStability"]
    assert len(report.theorems) == 8
    assert bool(applicable[0].note) == (kind == "het"), "what the proof drops"
    assert all(one.note for one in report.theorems if not one.applicable)
    json.dumps(report.document(), allow_nan=False)
    assert report.covered == (controller == "pd") == (not list(warnings(setting(builtin(name)))))
    if report.covered:
        assert (applicable[1].verdict, applicable[1].printed_verdict) == (Verdict.HOLDS, Verdict.FAILS)


def test_where_the_papers_manifold_leaves_the_plane_is_noted() -> None:
    (note,) = (note for note in check("pd_het_4").notes if note.startswith("manifold: "))
    assert "|tau| above 2.288 N m" in note
    assert not any("manifold" in note for note in check("pd_het_4", "manifold.torque_max=1.5").notes)


@pytest.mark.parametrize("noise", ["plane.sensor.noise=[0.01, 0]", "swarm.sensor.noise=[0, 0.01]"])
def test_what_the_theorems_assume_of_sensors_is_noted(noise: str) -> None:
    assert not any("sensors" in note for note in check("pd_het_4").notes)
    assert "the theorems assume perfect sensors" in check("pd_het_4", noise).notes


def far_out(kd: float) -> tuple[str, ...]:
    """Return double integrators that start at the ends of the plane."""
    positions = (f"swarm.agents.{i}.position={0.5 if i % 2 else -0.5}" for i in range(4))
    return f"swarm.gains.kd=[{kd}, {kd}]", *positions


START, AT_REST = {"initial state"}, {"ks, all terms at rest", "initial state"}


@pytest.mark.parametrize(
    ("name", "overrides", "failing"),
    [
        ("pd_het_4", ("plane.angle=0.3",), START),
        ("pd_het_4", ("controller.gains=[3, -2]",), {"k2", "Lyapunov function", *START}),
        ("pd_het_4", ("controller.gains=[-3, 2]",), {"k1", *START}),
        ("pd_het_4", ("plane.disturbance.amplitude=0.1",), {"disturbance"}),
        ("pd_het_4", ("manifold.torque_max=1.5",), {"torque limit"}),
        ("arise_si_4", ("controller.ks=143.9",), {"ks, friction alone", *AT_REST}),
        ("arise_si_4", ("controller.ks=144.1",), AT_REST),
        ("arise_si_4", ("controller.ks=3000", "controller.gamma=[1, 1, 1, 1]"), set()),
        (
            "arise_si_4",
            ("plane.disturbance={amplitude: 1.0, angular_frequency: 0.5}",),
            {"beta", "ks, friction alone", *AT_REST},
        ),
        ("pd_di_4", far_out(1.0), {"inertia swing", *START}),
        ("pd_di_4", far_out(6.4), START),
        ("pd_si_4", ("step=0.25", "duration=5.0"), {"period, SI errors", "delay, SI errors"}),
        pytest.param(
            "pd_si_4",
            ("faults=[{kind: delay, steps: 2147483647}]",),
            {"period, SI errors", "delay, SI errors"},
            marks=pytest.mark.system,
        ),
    ],
)
def test_what_fails_is_named(name: str, overrides: tuple[str, ...], failing: set[str]) -> None:
    report = check(name, *overrides)
    failed = {one.name for theorem, one in report.failed if not theorem.label.startswith("General")}
    assert {one for one in failed if "plane" not in one} == failing
    lines = list(warnings(setting(builtin(name, *overrides))))
    assert any(line.startswith("sampled time: ") for line in lines) == any("period" in one for one in failed)
    unsaid = {"k1", "inertia swing", *(AT_REST if "ks, friction alone" in failing else ())}
    said = {"ks, friction alone": "does not cover this run: the friction's slope at rest, 24 N m s/rad"}
    for one in failing - unsaid:
        assert said.get(one, f"{one}: ") in " ".join(lines)


def test_another_bound_of_the_angle_gives_another_set() -> None:
    scenario = builtin("pd_si_4", "plane.angle=0.18")
    assert [check_scenario(scenario, bound).covered for bound in (0.2, 0.25)] == [False, True]


UNEVEN = (
    *("swarm.gains={k: [11, 9], kp: [8, 7], kd: [5, 4], ksd: 0.7}", "plane.angular_velocity=0.02", "plane.angle=0.05"),
    *("manifold={torque_max: 4, curvature: 0.013, offset: 0.03}", "plane.inertia=0.6", "plane.length=1.2"),
)
STRONG = ("controller.ks=3000", "controller.gamma=[3, 1, 0.9, 0.4]", "controller.alpha1=1.3", "controller.alpha2=2.4")
REPORTS = {
    "pd_si_4": (),
    "pd_het_4": UNEVEN,
    "pd_di_4": (
        "controller.type=lqr",
        "manifold.torque_max=0.3",
        *UNEVEN[:3],
        "step=0.02",
        "swarm.agents.0.velocity=0.3",
    ),
    "arise_si_4": (*UNEVEN[:3], *STRONG, "manifold.torque_max=0.3"),
    "arise_het_20": ("manifold={curvature: 0.02, offset: 0.9}",),
    "arise_het_4": (*UNEVEN, *STRONG, "faults=[{kind: delay, steps: 3}]", "swarm.agents.2.velocity=0.3"),
    "arise_het_200": (),
    "pd_het_4 soft": (*UNEVEN, "controller.gains=[0.3, 3.1]", "swarm.agents.2.velocity=0.1"),
    "pd_di_4 at once": (*UNEVEN, "swarm.agents.1.velocity=-0.2", "plane.robot_gravity=true"),
    "arise_si_4 weak": (
        *(*UNEVEN, "controller.alpha1=1.3", "controller.alpha2=2.4", "controller.ks=0.5", "step=0.005"),
        "plane.friction=[0, 1000, 700, 0, 1000, 1]",
    ),
    "arise_di_4": (*UNEVEN, *STRONG, "controller.trajectory={type: constant, angle: 0.05}"),
}


def numbers(node: object, path: str = "") -> dict[str, object]:
    """Return all numbers, names, verdicts and classes of a document by their places, and none of its prose."""
    if isinstance(node, dict):
        return {key: value for name, part in node.items() for key, value in numbers(part, f"{path}.{name}").items()}
    if isinstance(node, list):
        return {key: value for i, part in enumerate(node) for key, value in numbers(part, f"{path}.{i}").items()}
    if isinstance(node, str) and not path.endswith(("verdict", ".class", ".name", ".label")):
        return {}
    return {path: float(f"{node:.9g}") if isinstance(node, float) else node}


@pytest.mark.parametrize("name", REPORTS)
def test_numbers_of_reports_are_frozen(name: str) -> None:
    """The tests above and `tests/errata` say that they are right; here none changes unnoticed.

    After a change that is meant: `python -m tests.swarmabs_core.theory.test_check`.
    """
    frozen = json.loads(FROZEN.read_text(encoding="utf-8"))[name]
    found = numbers(check(name.split(maxsplit=1)[0], *REPORTS[name]).document())
    measured = {place for place, value in frozen.items() if isinstance(value, float)}
    assert {place: found[place] for place in measured} == pytest.approx(
        {place: frozen[place] for place in measured}, rel=1e-6, abs=1e-12
    )
    assert {**found, **{place: frozen[place] for place in measured}} == frozen


if __name__ == "__main__":
    documents = {
        name: numbers(check(name.split(maxsplit=1)[0], *overrides).document()) for name, overrides in REPORTS.items()
    }
    lines = [f"{json.dumps(name)}: {json.dumps(found, allow_nan=False)}" for name, found in documents.items()]
    FROZEN.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
