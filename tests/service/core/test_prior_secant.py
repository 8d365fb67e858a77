import numpy as np

from service.core.prior_secant import next_places


def formula(places: list[np.ndarray], directions: list[np.ndarray]) -> np.ndarray:
    """The same for one load, in a few lines."""
    middle, rest = places[-1], directions[-1]
    earlier = range(len(places) - 2, max(len(places) - 4, -1), -1)
    if earlier:
        moves = np.stack([(places[-1] - places[k]).ravel() for k in earlier])
        changes = np.stack([(directions[-1] - directions[k]).ravel() for k in earlier])
        normal = changes @ changes.T
        normal += 1e-4 * np.trace(normal) / len(normal) * np.eye(len(normal))
        share = np.clip(np.linalg.solve(normal, changes @ rest.ravel()), -2.0, 2.0)
        length = min(1.0, np.linalg.norm(moves[0]) / np.linalg.norm(changes[0]))
        middle = middle - (share @ moves).reshape(middle.shape)
        rest = length * (rest - (share @ changes).reshape(rest.shape))
    return np.asarray(middle + rest * min(1.0, 0.2 / np.abs(rest).max()))


def test_places_follow_the_formula_whatever_the_number_of_earlier_ones() -> None:
    rng = np.random.default_rng(0)
    places, directions = rng.normal(0.0, 0.1, (2, 5, 2, 3, 7)).astype(np.float32)
    directions[:, 1] *= 0.1  # one load takes its whole steps, the other does not
    for step in range(4):
        next_places(places, directions, step)
        for load in range(2):
            expected = formula(list(places[: step + 1, load]), list(directions[: step + 1, load]))
            np.testing.assert_allclose(places[step + 1, load], expected, atol=1e-5)


def test_without_corrections_nothing_moves() -> None:
    places = np.zeros((4, 1, 3, 5), np.float32)
    directions = np.zeros((3, 1, 3, 5), np.float32)
    for step in range(3):
        next_places(places, directions, step)
    np.testing.assert_array_equal(places, 0.0)
