import time

import numpy as np
import pytest

from service.core.lookup import warp
from service.core.prior import CELLS, STEPS, ElasticPrior
from service.core.prior_assembly import solve_at_rest
from service.core.prior_element import FLOOR_STIFFNESS
from service.core.prior_forces import missing_forces
from service.core.prior_grid import CellGrid
from service.core.prior_unrolling import unroll


def column(width: int = 16, height: int = 48) -> np.ndarray:
    """A square column in the middle of the cube."""
    rest = np.zeros((64, 64, 64), bool)
    side = slice(32 - width // 2, 32 + width // 2)
    rest[side, side, :height] = True
    return rest


def push(contact: tuple[float, float, float], direction: tuple[float, float, float], load: float) -> np.ndarray:
    return np.array([*contact, *direction, np.log10(load), 0.3, 0.2], np.float32)


def test_a_column_is_compressed_by_f_l_over_e_a() -> None:
    """δ = F h/(E A) (Hooke), plus what the bed under the sole gives way: F/(κ A) with κ = 300 E/L."""
    prior = ElasticPrior(column(), 0.0)
    load = 1e-4
    force = np.zeros((1, 3, len(prior.grid.nodes)), np.float32)
    top = prior.grid.nodes[:, 2] == prior.grid.shape[2]
    # the top face's bilinear nodes share a uniform traction by their area
    share = np.prod([np.where((prior.grid.nodes[:, a] % prior.grid.shape[a]) == 0, 1, 2) for a in (0, 1)], axis=0)
    force[0, 2, top] = -load * (share[top] / share[top].sum())
    u, _ = prior.solver.solve(force, 0)
    expected = load * 0.75 / 0.0625 + load / (FLOOR_STIFFNESS * 0.0625)
    # float32 pivots
    np.testing.assert_allclose(u[0, 2, top], -expected, rtol=1e-3)


def test_a_slender_column_bends_by_the_formula_of_timoshenko() -> None:
    """δ = F h³/(3 E I) + F h/(κ G A) at the tip, with the contact patch's middle as the tip; the sole's bed adds
    F h²/(κ_bed I)."""
    width, height, load = 8 / 64, 60 / 64, 1e-6
    prior = ElasticPrior(column(8, 60), 0.3)
    solution = prior.displacements([push((0.5 - width / 2, 0.5, height - 0.1), (1.0, 0.0, 0.0), load)], steps=0)
    lever = height - 0.1
    inertia, shear = width**4 / 12, 0.5 / 1.3
    bent = load * lever**3 / (3 * inertia) + load * lever / (5 / 6 * shear * width**2)
    expected = bent + load * lever**2 / (FLOOR_STIFFNESS * inertia)
    at = int(lever * 32)
    field = solution.backward[0]
    assert field[0, 15:17, 15:17, at - 1 : at + 1].mean() == pytest.approx(expected, rel=0.1)


def test_mirrored_loads_have_mirrored_solutions() -> None:
    prior = ElasticPrior(column(), 0.45)
    left = push((0.375, 0.5, 0.6), (1.0, 0.0, 0.0), 5e-4)
    right = push((0.625, 0.5, 0.6), (-1.0, 0.0, 0.0), 5e-4)
    one, other = prior.displacements([left, right]).nodal
    index = prior.grid.nodes * [-1, 1, 1] + [prior.grid.shape[0], 0, 0]
    mirror = [int(np.flatnonzero((prior.grid.nodes == node).all(axis=1))[0]) for node in index]
    expected = other[:, mirror] * np.array([[-1.0], [1.0], [1.0]])
    assert np.abs(one).max() > 0.1
    # float32 pivots
    np.testing.assert_allclose(one, expected, atol=2e-3 * np.abs(one).max())


def test_no_load_to_speak_of_moves_nothing_and_the_answer_is_linear_there() -> None:
    prior = ElasticPrior(column(), 0.3)
    small, twice = (push((0.375, 0.5, 0.6), (1.0, 0.0, 0.0), load) for load in (1e-7, 2e-7))
    fields = prior.displacements([small, twice]).nodal
    np.testing.assert_allclose(fields[1], 2.0 * fields[0], atol=2e-3 * np.abs(fields[1]).max())
    assert np.abs(fields).max() < 1e-4


def test_loads_solved_together_are_those_solved_alone() -> None:
    prior = ElasticPrior(column(), 0.3)
    loads = [push((0.375, 0.5, z), (0.8, 0.6, 0.0), 2e-3) for z in (0.3, 0.5, 0.7)]
    together = prior.displacements(loads)
    for i, load in enumerate(loads):
        alone = prior.displacements([load])
        np.testing.assert_allclose(together.backward[i], alone.backward[0], atol=5e-3)  # float32, in two ways


def test_corrections_bring_the_forces_into_balance_where_the_column_bends_far() -> None:
    """A thin column bent until its tip has gone sideways by more than a third of its height."""
    prior = ElasticPrior(column(8, 56), 0.3)
    force = prior.forces([push((0.4375, 0.5, 0.8), (1.0, 0.0, 0.0), 5e-5)])
    left = {}
    for steps in (0, 8):
        u, _ = prior.solver.solve(force, steps)
        left[steps] = float(np.abs(prior.solver.correction(u, force)).max())
    assert np.abs(u[:, 0]).max() > 0.3
    assert left[8] < 0.04 * np.abs(u).max()
    assert left[8] < 0.04 * left[0]


@pytest.mark.parametrize("load", [1e-6, 1e-5, 5e-5, 2e-4])
def test_an_answer_is_corrected_until_it_balances(load: float) -> None:
    """However far the column bends, one more correction would hardly move it."""
    prior = ElasticPrior(column(8, 56), 0.3)
    force = prior.forces([push((0.4375, 0.5, 0.8), (1.0, 0.0, 0.0), load)])
    u, balanced = prior.solver.solve(force, STEPS)
    assert balanced.all()
    assert np.abs(prior.solver.correction(u, force)).max() < 0.02 * np.abs(u).max()


def test_a_load_that_balances_early_waits_for_no_other() -> None:
    """Answers of a batch are those of each alone, in whatever order they are found."""
    prior = ElasticPrior(column(8, 56), 0.3)
    loads = [push((0.4375, 0.5, 0.8), (1.0, 0.0, 0.0), load) for load in (5e-5, 1e-7, 2e-4, 1e-6)]
    together, _ = prior.nodal(loads)
    for load, u in zip(loads, together, strict=True):
        np.testing.assert_allclose(u, prior.nodal([load])[0][0], atol=1e-3 * np.abs(u).max())


def test_a_load_under_which_thin_walls_crumple_is_given_up_and_answered_by_the_unrolled_linear_solution() -> None:
    """It would take hundreds of steps. No cell is inside out, and a harder push goes no less far."""
    x, y, z = np.indices((64, 64, 64)) - np.array([31.5, 31.5, 0.0])[:, None, None, None]
    radius = np.sqrt(x**2 + y**2)
    prior = ElasticPrior((radius < 24) & ((radius > 22) | (z < 3)) & (z < 44), 0.49)
    loads = [push((0.867, 0.5, 0.6), (-1.0, 0.0, 0.0), load) for load in (1e-5, 1e-4, 3e-4, 1e-3, 3e-3, 1e-2)]
    force = prior.forces(loads)
    answers, balanced = prior.solver.solve(force, STEPS)
    assert balanced[:2].all() and not balanced[3:].any()
    peaks = np.abs(answers).max(axis=(1, 2))
    assert (np.diff(peaks) > -1e-3 * peaks[-1]).all()
    missing = np.empty_like(force[0])
    for row in (3, 4, 5):
        linear, _ = prior.solver.solve(force[row : row + 1], 0)
        unrolled = np.empty_like(linear)
        unroll(prior.solver.cells, linear, unrolled)
        solve_at_rest(prior.solver.factor, unrolled, unrolled)
        np.testing.assert_allclose(answers[row], unrolled[0], atol=1e-4)  # a row alone is rounded otherwise
        assert missing_forces(prior.solver.cells, answers[row], force[row], missing) > 0.0
    gentle = prior.solver.correction(answers[:1], force[:1])
    assert np.abs(gentle).max() < 0.02 * np.abs(answers[0]).max()


def test_a_column_that_bends_far_keeps_its_volume() -> None:
    """A linear solution swells it; rotations do not."""
    rest = column(8, 56)
    prior = ElasticPrior(rest, 0.3)
    field = prior.displacements([push((0.4375, 0.5, 0.8), (1.0, 0.0, 0.0), 5e-5)], steps=6).backward[0]
    assert (warp(rest, field) > 0.5).sum() == pytest.approx(rest.sum(), rel=0.06)


def test_an_absurd_load_has_a_finite_answer_of_bounded_size() -> None:
    prior = ElasticPrior(column(8, 56), 0.49)
    solution = prior.displacements([push((0.4375, 0.5, 0.8), (1.0, 0.0, 0.0), load) for load in (1e-2, 1e2)])
    assert np.isfinite(solution.backward).all()
    assert np.abs(solution.nodal).max() < 3.0


def test_a_body_above_the_floor_stands_on_its_lowest_voxels() -> None:
    low, high = column(), np.roll(column(), 8, axis=2)
    u = ElasticPrior(low, 0.3).displacements([push((0.375, 0.5, 0.6), (1.0, 0.0, 0.0), 1e-3)]).nodal
    v = ElasticPrior(high, 0.3).displacements([push((0.375, 0.5, 0.725), (1.0, 0.0, 0.0), 1e-3)]).nodal
    np.testing.assert_allclose(u, v, atol=1e-4 * np.abs(u).max())


def test_islands_are_left_out_and_a_load_on_one_pushes_the_body() -> None:
    rest = column(16, 20)
    rest[30:34, 30:34, 50:60] = True
    solution = ElasticPrior(rest, 0.3).displacements([push((0.5, 0.5, 0.93), (0.0, 0.0, -1.0), 1e-4)])
    assert np.isfinite(solution.backward).all()
    assert np.abs(solution.nodal).max() < 0.05


def odd_bodies() -> dict[str, np.ndarray]:
    index = np.indices((64, 64, 64))
    diagonal = np.arange(64)
    bodies = {name: np.zeros((64, 64, 64), bool) for name in ("voxel", "sheet", "plate", "two voxels", "diagonal")}
    bodies["voxel"][10, 10, 0] = True
    bodies["sheet"][20] = True  # too slender for single precision
    bodies["plate"][:, :, 30] = True
    bodies["two voxels"][[5, 60], [60, 5], [40, 3]] = True
    bodies["diagonal"][diagonal, diagonal, diagonal] = True  # its lowest cell holds next to nothing
    bodies["cube"] = np.ones((64, 64, 64), bool)
    bodies["dust"] = np.random.default_rng(0).random((64, 64, 64)) < 1e-3
    bodies["noise"] = np.random.default_rng(1).random((64, 64, 64)) < 0.3
    bodies["shell"] = np.abs(np.sqrt(((index - 31.5) ** 2).sum(axis=0)) - 25.0) < 0.6
    bodies["hovering"] = bodies["cube"] & (index[2] > 50)
    bodies["feet"] = (index[2] < 8) & (np.abs(index[0] - 31.5) > 26)  # planes between them have no nodes
    return bodies


@pytest.mark.parametrize("name", odd_bodies())
def test_any_body_has_a_finite_answer_of_bounded_size_to_any_load(name: str) -> None:
    rest = odd_bodies()[name]
    contact = (np.argwhere(rest)[rest.sum() // 2] + 0.5) / 64
    loads = [push(tuple(contact), (0.6, 0.0, -0.8), load) for load in (1e-8, 1e-3, 1e3)]
    loads.append(push((-2.0, 5.0, 0.5), (0.0, 1.0, 0.0), 1e-3))
    solution = ElasticPrior(rest, 0.49).displacements(loads)
    for field in (solution.nodal, solution.backward, solution.forward):
        assert np.isfinite(field).all()
    assert np.abs(solution.nodal).max() <= 2.001


SYMMETRIES = ("x", "y", "swap", "turn")


@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_solutions_have_the_symmetries_of_the_square(symmetry: str) -> None:
    """Training augments with them; two of these make all eight."""
    rest = np.zeros((64, 64, 64), bool)
    rest[14:30, 10:50, :44] = True
    rest[14:52, 10:22, 30:44] = True  # no symmetry of its own
    load = push((52 / 64, 0.25, 0.58), (0.48, 0.6, -0.64), 2e-3)

    def image(body: np.ndarray, condition: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        condition = condition.copy()
        if symmetry in ("swap", "turn"):
            body, condition = body.transpose(1, 0, 2), condition[[1, 0, 2, 4, 3, 5, 6, 7, 8]]
        if symmetry in ("x", "y", "turn"):
            axis = int(symmetry == "y")
            body = np.flip(body, axis)
            condition[axis], condition[3 + axis] = 1.0 - condition[axis], -condition[3 + axis]
        return np.ascontiguousarray(body), condition

    def image_of_field(field: np.ndarray) -> np.ndarray:
        if symmetry in ("swap", "turn"):
            field = field[[1, 0, 2]].transpose(0, 2, 1, 3)
        if symmetry in ("x", "y", "turn"):
            axis = int(symmetry == "y")
            field = np.flip(field, 1 + axis).copy()
            field[axis] *= -1.0
        return field

    field = ElasticPrior(rest, 0.3).displacements([load]).backward[0]
    other, its_load = image(rest, load)
    its_field = ElasticPrior(other, 0.3).displacements([its_load]).backward[0]
    peak = np.abs(field).max()
    assert peak > 0.1
    np.testing.assert_allclose(its_field, image_of_field(field), atol=1e-3 * peak)


def test_an_empty_body_is_refused() -> None:
    with pytest.raises(ValueError, match="no voxel"):
        ElasticPrior(np.zeros((64, 64, 64), bool), 0.3)


def test_octants_hold_the_volume_of_the_body() -> None:
    rest = np.random.default_rng(0).random((64, 64, 64)) < 0.3
    grid = CellGrid.fit(rest, CELLS)
    assert grid.fill.sum() * grid.edges.prod() == pytest.approx(rest.sum() / 64**3, rel=1e-4)


def test_it_is_fast_enough_to_serve() -> None:
    """Measured 5 to 10 ms for set-up and first load, the more the fuller the box; the bound is for the worst test
    machine, with everything else at work on it."""
    rest, load = column(24), push((0.3125, 0.5, 0.6), (1.0, 0.0, 0.0), 1e-3)

    def once() -> float:
        start = time.process_time()
        ElasticPrior(rest, 0.3).displacements([load])
        return time.process_time() - start

    assert min(once() for _ in range(5)) < 0.1


def test_the_field_of_a_guess_is_held_and_that_of_a_balance_is_not() -> None:
    """What droops in a guess may be a wall that crumples; the body is not to stand on it."""
    prior = ElasticPrior(column(), 0.3)
    nodal = np.full((2, 3, len(prior.grid.nodes)), [[[0.3], [0.0], [-0.3]]], np.float32)
    free, guess = prior.backward(nodal, np.array([True, False]))
    height = (np.arange(32) + 0.5) / 32
    assert (np.linalg.norm(free, axis=0) > height).any()
    assert (np.linalg.norm(guess, axis=0) <= height + 1e-6).all()
    np.testing.assert_array_equal(guess[:, :, :, 20:], free[:, :, :, 20:])
