import numpy as np

from service.core.prior_secant import MEMORY, put_on, remember, take_off

N = 7


def steps(count: int, stiffness: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    moves = np.random.default_rng(0).normal(size=(count, 3, N)).astype(np.float32)
    return moves, (moves.reshape(count, -1) @ stiffness).reshape(moves.shape).astype(np.float32)


def stiffness() -> np.ndarray:
    root = np.random.default_rng(1).normal(size=(3 * N, 3 * N))
    return np.asarray(root @ root.T / (3 * N) + np.eye(3 * N))


def direction(moves: np.ndarray, changes: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """By the kernels, around a body whose stiffness at rest is one."""
    kept = np.zeros((2, MEMORY, 3, N), np.float32)
    scales, shares, count = np.zeros(MEMORY, np.float32), np.zeros(MEMORY, np.float32), 0
    for move, change in zip(moves, changes, strict=True):
        count = remember(move, change, kept[0], kept[1], scales, count)
    result = forces.copy()
    take_off(kept[0], kept[1], scales, count, shares, result)
    put_on(kept[0], kept[1], scales, count, shares, result)
    return result


def test_directions_are_those_of_the_formula_of_broyden_fletcher_goldfarb_and_shanno() -> None:
    """H ← (1 − s yᵀ/sᵀy) H (1 − y sᵀ/sᵀy) + s sᵀ/sᵀy, step by step, of as many as are remembered."""
    moves, changes = steps(MEMORY + 3, stiffness())
    forces = np.random.default_rng(2).normal(size=(3, N)).astype(np.float32)
    inverse = np.eye(3 * N)
    for s, y in zip(moves[3:].reshape(MEMORY, -1), changes[3:].reshape(MEMORY, -1), strict=True):
        project = np.eye(3 * N) - np.outer(y, s) / (s @ y)
        inverse = project.T @ inverse @ project + np.outer(s, s) / (s @ y)
    expected = (inverse @ forces.ravel()).reshape(3, N)
    np.testing.assert_allclose(direction(moves, changes, forces), expected, atol=1e-4)


def test_the_last_change_of_forces_leads_back_along_its_step() -> None:
    """The secant equation."""
    moves, changes = steps(4, stiffness())
    np.testing.assert_allclose(direction(moves, changes, changes[-1]), moves[-1], atol=1e-4)


def test_a_step_along_which_forces_do_not_grow_is_not_remembered() -> None:
    moves, changes = steps(2, stiffness())
    forces = np.random.default_rng(2).normal(size=(3, N)).astype(np.float32)
    without = direction(moves[:1], changes[:1], forces)
    np.testing.assert_array_equal(direction(moves, np.stack([changes[0], -changes[1]]), forces), without)
    nothing = np.zeros((1, 3, N), np.float32)
    np.testing.assert_array_equal(direction(nothing, nothing, forces), forces)
