import numpy as np

from service.core.smoothing import smoothed, sure_of


def test_smoothing_is_a_mean_of_weights_one_two_one() -> None:
    rest = np.random.default_rng(8).random((9, 12, 70)) < 0.4
    mean = np.pad(rest.astype(np.float64), 1)
    mean[:, :, 0] = mean[:, :, 1]  # what stands on the floor goes on
    for axis in range(3):
        mean = np.apply_along_axis(np.convolve, axis, mean, [0.25, 0.5, 0.25], "valid")
    np.testing.assert_allclose(smoothed(rest), sure_of(rest, mean.astype(np.float32)), atol=1e-6)


def test_smoothing_finds_a_surface_between_voxels() -> None:
    """A half space under a plane that cuts the voxels askew: ½ is crossed within a third of a voxel of the plane."""
    x, y, z = (np.indices((24, 24, 24)) + 0.5).astype(np.float32)
    normal = np.array([0.27, 0.13, 1.0]) / np.linalg.norm([0.27, 0.13, 1.0])
    height = normal[0] * x + normal[1] * y + normal[2] * z - 14.2
    values = smoothed(height < 0.0)
    raw = (height < 0.0).astype(np.float32)

    def missed(field: np.ndarray) -> float:
        below = field[8:16, 8:16, 3:21]
        column = np.argmax(below < 0.5, axis=2)
        first, last = (np.take_along_axis(below, (column - i)[..., None], 2)[..., 0] for i in (1, 0))
        crossing = 3.5 + column - 1 + (first - 0.5) / (first - last)
        truth = (14.2 - normal[0] * x[8:16, 8:16, 0] - normal[1] * y[8:16, 8:16, 0]) / normal[2]
        return float(np.sqrt(np.mean((crossing - truth) ** 2)))

    assert missed(values) < 0.2 < missed(raw)


def test_a_rod_one_voxel_thin_survives_smoothing() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[30, 30, :40] = True
    np.testing.assert_array_equal(smoothed(rest) > 0.5, rest)
