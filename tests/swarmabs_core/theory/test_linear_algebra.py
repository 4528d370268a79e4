"""The numerics of the theory against SciPy."""

import numpy as np
import pytest
from scipy.linalg import expm, schur, solve_discrete_lyapunov
from scipy.optimize import minimize_scalar

from swarmabs_core.theory.linear_algebra import discrete_lyapunov, exponential, minimum, subspace_outside


def random() -> np.random.Generator:
    """Return numbers that do not depend on which tests ran before."""
    return np.random.default_rng(30)


@pytest.mark.parametrize("size", [1, 3, 6])
@pytest.mark.parametrize("scale", [0.0, 1e-4, 1.0, 60.0])
def test_exponential(size: int, scale: float) -> None:
    draw = random()
    for _ in range(20):
        matrix = scale * draw.normal(size=(size, size))
        wanted = expm(matrix)
        assert np.abs(exponential(matrix) - wanted).max() <= 1e-11 * np.abs(wanted).max()


def test_exponential_of_a_matrix_that_cannot_be_diagonalised() -> None:
    assert exponential(np.array([[-2.0, 1.0], [0.0, -2.0]])) == pytest.approx(
        np.exp(-2.0) * np.array([[1.0, 1.0], [0.0, 1.0]]), rel=1e-14
    )


@pytest.mark.parametrize("size", [1, 4, 9])
def test_discrete_lyapunov(size: int) -> None:
    matrix = random().normal(size=(size, size))
    matrix *= 0.95 / np.abs(np.linalg.eigvals(matrix)).max()
    assert discrete_lyapunov(matrix, np.eye(size)) == pytest.approx(
        solve_discrete_lyapunov(matrix, np.eye(size)), rel=1e-8, abs=1e-10
    )


@pytest.mark.parametrize("near", [(), (1.0,), (1.0 + 1e-9, 1.0 - 2e-9), (1.0, 1.0, 1.0)])
def test_subspace_of_eigenvalues_outside_a_circle(near: tuple[float, ...]) -> None:
    blocks = np.diag([*near, 0.9, 0.9, 0.999, -0.3, 1.2])
    blocks[len(near), len(near) + 1] = 1.0  # a Jordan block
    change = random().normal(size=blocks.shape)
    matrix = change @ blocks @ np.linalg.inv(change)
    found = subspace_outside(matrix, 1.0, 1e-6)
    _, basis, count = schur(matrix, sort=lambda real, imaginary: abs(complex(real, imaginary) - 1.0) > 1e-6)
    assert found.shape == (len(blocks), count) == (len(blocks), 5)
    assert found.T @ found == pytest.approx(np.eye(count), abs=1e-12)
    assert found @ found.T == pytest.approx(basis[:, :count] @ basis[:, :count].T, abs=1e-7)


def test_minimum() -> None:
    def function(x: float) -> float:
        return float(np.cosh(x - 0.3) + 0.1 * x)

    wanted = minimize_scalar(function, bounds=(-1.0, 2.0), method="bounded", options={"xatol": 1e-10}).fun
    assert minimum(function, -1.0, 2.0) == pytest.approx(wanted, rel=1e-12)
    assert minimum(lambda x: x, 0.5, 2.0) == pytest.approx(0.5, rel=1e-9), "at an end"
