from __future__ import annotations

import pytest

from swarmabs_core.controllers import CONTROLLERS, Arise, ParentContext, StateFeedback
from swarmabs_core.errors import InputError
from swarmabs_core.manifold import Manifold
from swarmabs_core.messages import PlaneState
from swarmabs_core.plant import Friction

CONTEXT = ParentContext(0.01, 0.5, Friction(0.01, 1000.0, 700.0, 0.02, 1000.0, 1.0), Manifold(0.0125, 0.025, 5.0))


@pytest.mark.parametrize("name", sorted(CONTROLLERS.built_in))
def test_defaults_pass_their_own_checks(name: str) -> None:
    for parameter in CONTROLLERS.find(name).settings:
        assert parameter.check(parameter.default) == parameter.default
        assert parameter.description


def test_pd() -> None:
    assert CONTROLLERS.make("pd", {}, CONTEXT) == StateFeedback(3.1623, 3.2859)
    assert CONTROLLERS.make("pd", {"gains": (1, 2)}, CONTEXT) == StateFeedback(1.0, 2.0)


def test_lqr_is_linearised_with_the_swarm_at_rest() -> None:
    """Inertia 0.5 + 0.025, viscous friction g6 = 1: the corrected gains of the paper."""
    law = CONTROLLERS.make("lqr", {}, CONTEXT)
    assert isinstance(law, StateFeedback)
    assert (law.k1, law.k2) == pytest.approx((3.1623, 1.3066), abs=5e-5)


def test_arise_takes_its_settings() -> None:
    law = CONTROLLERS.make("arise", {"trajectory.type": "constant", "trajectory.angle": 0.3}, CONTEXT)
    assert isinstance(law, Arise)
    assert law.reference(5.0) == 0.3
    other = CONTROLLERS.make(
        "arise",
        {"trajectory.amplitude": 0.1, "trajectory.angular_frequency": 1.0, "adaptive_initial": (0, 0, 0, 2)},
        CONTEXT,
    )
    # Only g6 is estimated: Y_d lambda = 2 th_d'(0) = 0.2.
    assert other.torque(0.0, PlaneState(0, 0, 0.0, 0.0)) == pytest.approx(-0.2, rel=1e-14)


def test_unknown_controller() -> None:
    with pytest.raises(InputError, match=r"no parent controller 'pid'; there are arise, lqr, pd"):
        CONTROLLERS.make("pid", {}, CONTEXT)


@pytest.mark.parametrize(
    ("name", "settings", "text"),
    [
        ("pd", {"gain": (1.0, 2.0)}, r"parent controller 'pd' has no parameter 'gain'; it has gains"),
        ("pd", {"gains": (1.0,)}, "2 elements"),
        ("lqr", {"r": 0.0}, "more than 0"),
        ("arise", {"trajectory.type": "square"}, "one of sine, constant"),
        ("arise", {"smoothing": 0.0}, "more than 0"),
    ],
)
def test_settings_that_are_refused(name: str, settings: dict[str, float], text: str) -> None:
    with pytest.raises(InputError, match=text):
        CONTROLLERS.make(name, settings, CONTEXT)
