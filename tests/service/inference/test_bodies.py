import numpy as np

from service.core.condition import POISSON_RATIO_MAX
from service.core.lookup import Inside
from service.core.spread import in_turn
from service.inference.bodies import KEPT_BODIES, KEPT_SOLVERS, Bodies

BLOCK = np.zeros((64, 64, 64), bool)
BLOCK[24:40, 20:44, 0:44] = True


def bodies() -> Bodies:
    return Bodies(lambda tensor: {"filled": tensor.sum()}, in_turn)


def test_the_same_array_is_the_same_body() -> None:
    kept, twin, inside = bodies(), BLOCK.copy(), Inside(BLOCK.astype(np.float32), probable=True)
    body = kept.find(BLOCK, None)
    assert kept.find(BLOCK, None) is body
    assert kept.find(twin, None) is not body
    assert kept.find(BLOCK, inside) is not body
    assert kept.find(BLOCK, None) is body


def test_those_asked_about_last_are_kept() -> None:
    kept = bodies()
    arrays = [BLOCK.copy() for _ in range(KEPT_BODIES + 1)]
    first, second, *_ = [kept.find(array, None) for array in arrays[:-1]]
    assert kept.find(arrays[0], None) is first
    kept.find(arrays[-1], None)
    assert kept.find(arrays[0], None) is first
    assert kept.find(arrays[1], None) is not second


def test_a_body_is_encoded_when_asked_and_looked_up_as_it_is() -> None:
    body = bodies().find(BLOCK, None)
    assert body.features() is body.features()
    assert body.features()["filled"] == BLOCK.sum()
    assert body.warp().body == ((24 / 64, 20 / 64, 0.0), (40 / 64, 44 / 64, 44 / 64))


def test_a_solver_is_kept_by_the_ratio_as_conditions_carry_it() -> None:
    body = bodies().find(BLOCK, None)
    solver = body.solver(0.3)
    assert body.solver(float(np.float32(0.3))) is solver
    assert body.solver(0.5) is body.solver(POISSON_RATIO_MAX)
    for ratio in range(KEPT_SOLVERS):
        body.solver(0.1 * ratio)
    assert body.solver(0.3) is not solver
    assert body.solver(0.3)() is body.solver(0.3)()
