import numpy as np
import pytest

from service.core.condition import CONDITION_FIELDS, encode_condition, load_number
from service.core.grids import Grid
from tests.poses import pose

GRID = Grid(pitch_m=0.2 / 64, camera_from_grid=pose((0.0, 0.0, np.pi / 2), (1.0, 2.0, 3.0)))


def encode(**changes: object) -> dict[str, float]:
    request: dict[str, object] = {
        "grid": GRID, "contact_m": np.array([1.0, 2.1, 3.05]), "force_n": np.array([0.0, 4.0, 0.0]),
        "young_modulus_pa": 1e5, "poisson_ratio": 0.3, "patch_radius_m": None,
    }  # fmt: skip
    vector = encode_condition(**{**request, **changes})  # type: ignore[arg-type]
    return dict(zip(CONDITION_FIELDS, vector.tolist(), strict=True))


def test_contact_and_direction_are_seen_from_the_body_grid() -> None:
    condition = encode()
    contact = [condition[f"contact_{axis}"] for axis in "xyz"]
    direction = [condition[f"direction_{axis}"] for axis in "xyz"]
    # The grid's x axis is the camera's y: 0.1 m along it is half of the edge.
    np.testing.assert_allclose(contact, [0.5, 0.0, 0.25], atol=1e-6)
    np.testing.assert_allclose(direction, [1.0, 0.0, 0.0], atol=1e-6)


def test_load_number_is_force_over_stiffness_and_area() -> None:
    assert load_number(4.0, 1e5, 0.2) == pytest.approx(1e-3)
    assert encode()["log10_load_number"] == pytest.approx(-3.0)


def test_twice_the_force_on_twice_the_stiffness_is_the_same_question() -> None:
    assert encode(force_n=np.array([0.0, 8.0, 0.0]), young_modulus_pa=2e5) == encode()


def test_patch_radius_defaults_to_a_tenth_of_the_edge() -> None:
    assert encode()["patch_radius"] == pytest.approx(0.1)
    assert encode(patch_radius_m=0.03)["patch_radius"] == pytest.approx(0.15)


def test_an_incompressible_material_is_asked_as_049() -> None:
    assert encode(poisson_ratio=0.5)["poisson_ratio"] == pytest.approx(0.49)


def test_a_zero_force_has_no_condition() -> None:
    with pytest.raises(ValueError, match="zero force"):
        encode(force_n=np.zeros(3))
