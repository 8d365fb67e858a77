"""Statistics of the sensor model against the formulas it quotes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from training.simulation.sensor import (
    PERFECT,
    SensorModel,
    apply_sensor,
    axial_sigma_m,
    depth_edges,
    incidence_rad,
    lateral_sigma_px,
    sample_sensor,
    stereo_shadow,
)

SHAPE = (240, 320)
FOCAL_PX = 500.0


def flat(depth_m: float) -> np.ndarray:
    return np.full(SHAPE, depth_m, np.float32)


def step(near_m: float = 0.8, far_m: float = 1.0) -> np.ndarray:
    depth = flat(far_m)
    depth[60:180, 80:240] = near_m
    return depth


def test_a_perfect_sensor_changes_nothing() -> None:
    depth = step()
    depth[:10] = np.nan
    np.testing.assert_array_equal(apply_sensor(depth, np.random.default_rng(0), FOCAL_PX, PERFECT), depth)


@pytest.mark.parametrize("depth_m", [0.5, 1.0, 2.0, 3.0])
@pytest.mark.parametrize("correlation_px", [0.0, 2.0])
def test_axial_noise_has_the_quoted_deviation(depth_m: float, correlation_px: float) -> None:
    """σ_z = 0.0012 + 0.0019 (z − 0.4)² at normal incidence, also when neighbours' noise is alike."""
    model = replace(PERFECT, noise_scale=1.0, correlation_px=correlation_px)
    noisy = apply_sensor(flat(depth_m), np.random.default_rng(1), FOCAL_PX, model)
    expected = 0.0012 + 0.0019 * (depth_m - 0.4) ** 2
    assert np.std(noisy - depth_m) == pytest.approx(expected, rel=0.06)
    assert abs(np.mean(noisy - depth_m)) < 0.1 * expected


def test_formulas_at_a_hand_computed_point() -> None:
    """z = 1.4 m, θ = π/4: θ/(π/2 − θ) = 1."""
    depth, theta = flat(1.4), np.full(SHAPE, math.pi / 4, np.float32)
    assert axial_sigma_m(depth, theta)[0, 0] == pytest.approx(0.0012 + 0.0019 + 1e-4 / math.sqrt(1.4), rel=1e-5)
    assert lateral_sigma_px(theta)[0, 0] == pytest.approx(0.835, rel=1e-5)


def test_correlated_noise_is_alike_between_neighbours() -> None:
    def correlation(width_px: float) -> float:
        model = replace(PERFECT, noise_scale=1.0, correlation_px=width_px)
        noise = apply_sensor(flat(1.0), np.random.default_rng(2), FOCAL_PX, model) - 1
        return float(np.corrcoef(noise[:, :-1].ravel(), noise[:, 1:].ravel())[0, 1])

    assert abs(correlation(0.0)) < 0.02
    # Two samples one pixel apart under a Gaussian blur of σ: exp(−1/(4σ²)).
    assert correlation(2.0) == pytest.approx(math.exp(-1 / 16), abs=0.02)


def test_incidence_of_a_tilted_plane() -> None:
    """z = z₀ + u·tan(θ)·z/f to first order: the slope gives θ back."""
    columns = np.arange(SHAPE[1]) - SHAPE[1] / 2
    tangent = math.tan(math.radians(50))
    depth = np.broadcast_to(1 / (1 - tangent * columns / FOCAL_PX), SHAPE).astype(np.float32)
    theta = incidence_rad(depth, FOCAL_PX)
    assert np.degrees(theta[120, 160]) == pytest.approx(50, abs=0.5)


def test_edges_are_where_depth_jumps() -> None:
    edges = depth_edges(step())
    assert edges[60, 100] and edges[59, 100]
    assert not edges[120, 160] and not edges[10, 10]
    assert edges.sum() == pytest.approx(2 * 2 * (120 + 160), rel=0.03)


def test_edge_dropout_has_its_rate_and_stays_at_edges() -> None:
    lost = np.isnan(apply_sensor(step(), np.random.default_rng(3), FOCAL_PX, replace(PERFECT, edge_dropout=0.4)))
    edges = depth_edges(step())
    assert lost[edges].mean() == pytest.approx(0.4, abs=0.06)
    assert not lost[~edges].any()


def test_grazing_surfaces_fail() -> None:
    columns = np.arange(SHAPE[1]) - SHAPE[1] / 2
    tilt = {}
    for degrees in (60, 84, 88):
        tangent = math.tan(math.radians(degrees))
        depth = np.broadcast_to(1 / (1 - tangent * columns / (FOCAL_PX * 40)), SHAPE).astype(np.float32)
        model = replace(PERFECT, grazing_limit_rad=math.radians(80))
        tilt[degrees] = np.isnan(apply_sensor(depth, np.random.default_rng(4), FOCAL_PX * 40, model)).mean()
    assert tilt[60] == 0
    assert tilt[84] == pytest.approx(0.4, abs=0.05)
    assert tilt[88] == pytest.approx(0.8, abs=0.05)


def test_flying_pixels_lie_between_near_and_far() -> None:
    depth = step()
    flown = apply_sensor(depth, np.random.default_rng(5), FOCAL_PX, replace(PERFECT, flying_pixels=0.5))
    changed = flown != depth
    edges = depth_edges(depth)
    assert changed[edges].mean() == pytest.approx(0.5, abs=0.06)
    assert not changed[~edges].any()
    assert ((flown[changed] >= 0.8) & (flown[changed] <= 1.0)).all()


def test_quantisation_to_millimetres_and_in_disparity() -> None:
    depth = np.linspace(0.5, 2.5, SHAPE[0] * SHAPE[1], dtype=np.float32).reshape(SHAPE)
    coarse = apply_sensor(depth, np.random.default_rng(6), FOCAL_PX, replace(PERFECT, quantum_m=0.001))
    np.testing.assert_allclose(coarse * 1000, np.round(coarse * 1000), atol=1e-3)
    assert np.abs(coarse - depth).max() <= 0.0005 + 1e-6
    steps = apply_sensor(depth, np.random.default_rng(6), FOCAL_PX, replace(PERFECT, disparity_quantum=0.002))
    # A step of disparity is z² times as much in depth.
    assert np.abs(steps - depth).max() == pytest.approx(0.5 * 0.002 * 2.5**2, rel=0.05)


def test_holes_fall_on_the_object_and_speckle_has_its_rate() -> None:
    mask = np.zeros(SHAPE, bool)
    mask[100:140, 140:180] = True
    on = off = 0.0
    for seed in range(20):
        model = replace(PERFECT, holes=4.0, hole_radius_px=5.0)
        lost = np.isnan(apply_sensor(flat(1.0), np.random.default_rng(seed), FOCAL_PX, model, holes_near=mask))
        on, off = on + lost[mask].mean(), off + lost[~mask].mean()
    assert on > 10 * off > 0
    speckle = apply_sensor(flat(1.0), np.random.default_rng(7), FOCAL_PX, replace(PERFECT, speckle_dropout=0.01))
    assert np.isnan(speckle).mean() == pytest.approx(0.01, rel=0.15)


@pytest.mark.parametrize("side", [1, -1])
def test_the_shadow_beside_an_object_is_as_wide_as_the_disparities_differ(side: int) -> None:
    """f·b·(1/z_near − 1/z_far) = 500 · 0.08 · (1/0.8 − 1/1.0) = 10 pixels, on the second camera's far side."""
    depth = step(0.8, 1.0)
    lost = stereo_shadow(depth, side * FOCAL_PX * 0.08)
    expected = np.zeros(SHAPE, bool)
    expected[60:180, slice(70, 80) if side > 0 else slice(240, 250)] = True
    # The rim of the shadow is a question of half a pixel.
    assert (lost ^ expected).sum() <= 120
    read = apply_sensor(depth, np.random.default_rng(0), FOCAL_PX, replace(PERFECT, baseline_m=side * 0.08))
    assert np.array_equal(np.isnan(read), lost)


def test_readings_out_of_range_and_missing_ones_stay_missing() -> None:
    depth = flat(1.0)
    depth[:50], depth[50:100], depth[100:120] = 0.1, 9.0, np.nan
    read = apply_sensor(depth, np.random.default_rng(8), FOCAL_PX, replace(PERFECT, nearest_m=0.2, farthest_m=6.0))
    assert np.isnan(read[:120]).all()
    assert np.isfinite(read[120:]).all()


def test_a_drawn_sensor_repeats_from_its_seed_and_keeps_most_readings() -> None:
    depth = step()
    kept = []
    for seed in range(20):
        first = apply_sensor(depth, np.random.default_rng(seed), FOCAL_PX)
        again = apply_sensor(depth, np.random.default_rng(seed), FOCAL_PX)
        np.testing.assert_array_equal(first, again)
        kept.append(np.isfinite(first).mean())
        assert np.nanmedian(np.abs(first - depth)) < 0.004
    assert min(kept) > 0.9
    assert isinstance(sample_sensor(np.random.default_rng(0)), SensorModel)
