"""The whole pipeline, in-process, with the shipped models, on frames and shapes whose geometry is exact."""

import io
from dataclasses import replace

import numpy as np
import pytest

from service.core.arrays import Vector3
from service.core.camera import project
from service.core.errors import ContactOffBody, EmptyObject, InvalidRequest, ReconstructionGone
from service.core.grids import pack_bits
from service.core.materials import Material
from service.core.messages import (
    DeformRequest,
    DeformResult,
    EarlierReconstruction,
    EncodedImage,
    KnownShape,
    Load,
    Observation,
)
from service.core.smoothing import smoothed
from service.inference.registry import Models
from service.pipeline import Body, Pipeline, Stopwatch
from service.reconstructions import Reconstructions
from tests.poses import pose
from tests.synthetic_scenes import CAMERA, Box, TableScene, render

BOX = Box((-0.05, -0.04, 0.0), (0.05, 0.04, 0.14))
HEIGHT_M = 0.14
SOFT = Material(young_modulus_pa=5e4, poisson_ratio=0.4)

BRICK = np.zeros((64, 64, 64), bool)
BRICK[18:46, 22:42, 0:40] = True
BRICK_POSE = pose((0.4, -0.2, 0.9), (0.05, 0.02, 0.7))
BRICK_PITCH_M = 0.004


@pytest.fixture(scope="module")
def pipeline(models: Models) -> Pipeline:
    return Pipeline(models.reconstruction, models.deformation)


@pytest.fixture(scope="module")
def scene() -> TableScene:
    return render([BOX], noise_m=0.0005)


def encoded(depth_m: np.ndarray) -> EncodedImage:
    buffer = io.BytesIO()
    np.save(buffer, depth_m, allow_pickle=False)
    return EncodedImage("npy", buffer.getvalue())


def front(scene: TableScene, force_n: float = 3.0) -> Load:
    """A push on the upper half of the front face, away from the camera along the table."""
    point = scene.camera_from_table @ [0.0, -0.04, 0.1, 1.0]
    return Load(force_n=scene.camera_from_table[:3, :3] @ [0.0, force_n, 0.0], contact_m=point[:3])


def request(scene: TableScene, *loads: Load, material: Material = SOFT, **changes: object) -> DeformRequest:
    source = Observation(intrinsics=CAMERA, depth=encoded(scene.depth_m), up=scene.up)
    return DeformRequest(source, material, loads or (front(scene),), **changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def answer(pipeline: Pipeline, scene: TableScene) -> DeformResult:
    return pipeline.predict(request(scene, front(scene, 3.0), front(scene, 0.0), front(scene, 0.3)))


def brick(*loads: Load, up: Vector3 | None = None, **changes: object) -> DeformRequest:
    source = KnownShape(pack_bits(BRICK).tobytes(), BRICK_PITCH_M, BRICK_POSE, up=up)
    return DeformRequest(source, SOFT, loads or (brick_push(),), **changes)  # type: ignore[arg-type]


def brick_push(force_n: float = 2.0) -> Load:
    contact = BRICK_POSE @ [18 * BRICK_PITCH_M, 32 * BRICK_PITCH_M, 30 * BRICK_PITCH_M, 1.0]
    return Load(force_n=BRICK_POSE[:3, :3] @ [force_n, 0.0, 0.0], contact_m=contact[:3])


# --- from a frame ---


def test_every_grid_is_64_cubed_and_there_is_one_place_for_all(answer: DeformResult) -> None:
    assert answer.observed is not None
    grids = [answer.observed, answer.reconstruction, answer.reconstruction_probability]
    for load in answer.loads:
        grids += [load.deformed, load.probability, load.displacement_m[0]]
    assert {grid.shape for grid in grids} == {(64, 64, 64)}
    assert len(answer.loads) == 3


def test_the_grid_stands_on_the_table_under_the_box(answer: DeformResult, scene: TableScene) -> None:
    camera_from_grid = answer.grid.camera_from_grid
    np.testing.assert_allclose(camera_from_grid[:3, 2], scene.up, atol=0.02)
    floor = np.array([0.5, 0.5, 0.0, 0.0]) * answer.grid.edge_m + [0, 0, 0, 1]
    table_from_camera = np.linalg.inv(scene.camera_from_table)
    np.testing.assert_allclose((table_from_camera @ camera_from_grid @ floor)[:3], 0.0, atol=0.02)


def test_the_reconstruction_is_the_box(answer: DeformResult) -> None:
    """As tall as the box, standing, and covering what was seen of it within a voxel."""
    body = answer.reconstruction
    layers = np.flatnonzero(body.any(axis=(0, 1)))
    assert layers[0] <= 1
    assert (layers[-1] + 1) * answer.grid.pitch_m == pytest.approx(HEIGHT_M, rel=0.15)
    assert answer.observed is not None
    padded = np.pad(body, 1)
    near = np.zeros_like(body)
    for offset in np.ndindex(3, 3, 3):
        near |= padded[tuple(slice(o, o + 64) for o in offset)]
    assert (answer.observed & near).sum() / answer.observed.sum() > 0.97
    volume_m3 = body.sum() * answer.grid.pitch_m**3
    assert volume_m3 == pytest.approx(0.1 * 0.08 * 0.14, rel=0.5)


def test_no_force_moves_nothing(answer: DeformResult) -> None:
    still = answer.loads[1]
    np.testing.assert_array_equal(still.deformed, answer.reconstruction)
    np.testing.assert_array_equal(still.probability, answer.reconstruction_probability)
    assert not still.displacement_m.any()
    assert still.max_displacement_m == still.mean_displacement_m == still.load_number == 0.0


def test_what_the_camera_did_not_see_is_as_doubtful_after_a_push(pipeline: Pipeline, scene: TableScene) -> None:
    """A push too gentle to move anything leaves every probability, but for the edges of the body, which are held."""
    answer = pipeline.predict(request(scene, front(scene, 1e-6)))
    before, after = answer.reconstruction_probability, answer.loads[0].probability
    doubtful = (before > 0.6) & (before < 0.95) & answer.reconstruction
    assert doubtful.sum() > 100
    assert np.abs(after - before)[doubtful].max() < 0.02


def test_the_answer_to_each_load_is_its_own(answer: DeformResult) -> None:
    hard, _, gentle = answer.loads
    assert hard.max_displacement_m > 2 * gentle.max_displacement_m > 0.0
    assert hard.load_number == pytest.approx(10 * gentle.load_number)
    assert hard.load_number == pytest.approx(3.0 / (5e4 * answer.grid.edge_m**2))


def test_the_box_moves_with_the_push_and_metres_are_metres(answer: DeformResult, scene: TableScene) -> None:
    load = answer.loads[0]
    field = load.displacement_m[:, load.deformed]
    lengths = np.linalg.norm(field, axis=0)
    assert load.max_displacement_m == pytest.approx(float(lengths.max()), rel=1e-5)
    assert load.mean_displacement_m == pytest.approx(float(lengths.mean()), rel=1e-4)
    assert not load.displacement_m[:, ~load.deformed].any()
    direction = answer.grid.camera_from_grid[:3, :3].T @ scene.camera_from_table[:3, 1]
    assert direction @ field.mean(axis=1) > 0.5 * np.linalg.norm(field.mean(axis=1))
    assert 1e-4 < load.max_displacement_m < 0.1


def test_every_stage_is_timed(answer: DeformResult) -> None:
    assert set(answer.timing_ms) == {"decode", "segment", "voxelize", "reconstruct", "align", "deform", "total"}
    parts = sum(value for name, value in answer.timing_ms.items() if name != "total")
    assert 0.9 * parts <= answer.timing_ms["total"]
    assert all(value >= 0.0 for value in answer.timing_ms.values())


def test_the_answer_names_its_model(answer: DeformResult, models: Models) -> None:
    manifest = models.deformation.manifest
    assert (answer.model_name, answer.model_version) == (manifest.name, manifest.version)


def test_a_contact_named_by_its_pixel_is_the_point_seen_there(pipeline: Pipeline, scene: TableScene) -> None:
    by_point = front(scene)
    assert by_point.contact_m is not None
    x, y, z = by_point.contact_m
    pixel = (float(round(CAMERA.fx * x / z + CAMERA.cx)), float(round(CAMERA.fy * y / z + CAMERA.cy)))
    by_pixel = Load(force_n=by_point.force_n, contact_px=pixel)
    answers = [pipeline.predict(request(scene, load)).loads[0] for load in (by_point, by_pixel)]
    assert answers[1].max_displacement_m == pytest.approx(answers[0].max_displacement_m, rel=0.1)
    both = answers[0].deformed & answers[1].deformed
    assert both.sum() / (answers[0].deformed | answers[1].deformed).sum() > 0.95


def test_a_contact_off_the_body_is_refused_with_its_distance(pipeline: Pipeline, scene: TableScene) -> None:
    load = front(scene)
    assert load.contact_m is not None
    away = Load(load.force_n, load.contact_m + scene.up * 0.5)
    with pytest.raises(ContactOffBody) as caught:
        pipeline.predict(request(scene, load, away))
    assert caught.value.field == "loads[1].contact_m"
    assert caught.value.actual == pytest.approx(0.46, abs=0.03)


def test_an_incompressible_material_is_answered_as_nearly_so_and_flagged(
    pipeline: Pipeline, scene: TableScene
) -> None:
    answers = {
        ratio: pipeline.predict(request(scene, material=Material(5e4, ratio))).loads[0] for ratio in (0.49, 0.5)
    }
    assert "poisson_ratio_clamped" in answers[0.5].flags
    assert "poisson_ratio_clamped" not in answers[0.49].flags
    np.testing.assert_array_equal(answers[0.5].deformed, answers[0.49].deformed)


def test_a_contact_beside_the_surface_is_snapped_and_flagged(pipeline: Pipeline, scene: TableScene) -> None:
    load = front(scene)
    assert load.contact_m is not None
    beside = Load(load.force_n, load.contact_m - scene.camera_from_table[:3, 1] * 0.02)
    assert "contact_snapped" in pipeline.predict(request(scene, beside)).loads[0].flags


def test_a_table_without_an_object_is_empty(pipeline: Pipeline) -> None:
    with pytest.raises(EmptyObject):
        pipeline.predict(request(render([]), Load(np.array([0.0, 0.0, 1.0]), contact_px=(320.0, 240.0))))


def test_a_load_without_a_contact_is_named(pipeline: Pipeline, scene: TableScene) -> None:
    with pytest.raises(InvalidRequest) as caught:
        pipeline.predict(request(scene, front(scene), Load(np.array([0.0, 1.0, 0.0]))))
    assert caught.value.field == "loads[1].contact_px"


# --- from a known shape ---


def test_a_known_shape_keeps_its_volume_and_its_place(pipeline: Pipeline) -> None:
    result = pipeline.predict(brick())
    volume_m3 = result.reconstruction.sum() * result.grid.pitch_m**3
    assert volume_m3 == pytest.approx(BRICK.sum() * BRICK_PITCH_M**3, rel=0.03)
    centre = result.grid.camera_from_grid @ [*((np.argwhere(result.reconstruction).mean(axis=0) + 0.5)
                                               * result.grid.pitch_m), 1.0]  # fmt: skip
    given = BRICK_POSE @ [*((np.argwhere(BRICK).mean(axis=0) + 0.5) * BRICK_PITCH_M), 1.0]
    np.testing.assert_allclose(centre, given, atol=0.5 * result.grid.pitch_m)
    assert result.observed is None
    assert set(result.timing_ms) == {"decode", "align", "deform", "total"}


def test_a_known_shape_is_answered_in_its_own_voxels(pipeline: Pipeline) -> None:
    result = pipeline.predict(brick(brick_push(), brick_push(0.0)))
    np.testing.assert_array_equal(result.reconstruction, BRICK)
    np.testing.assert_array_equal(result.reconstruction_probability, BRICK)
    np.testing.assert_array_equal(result.grid.camera_from_grid, BRICK_POSE)
    assert result.grid.pitch_m == BRICK_PITCH_M
    np.testing.assert_array_equal(result.loads[1].deformed, BRICK)


def leaning() -> Vector3:
    """An `up` to which the brick's own grid does not stand upright: it is answered in the body grid."""
    up: Vector3 = BRICK_POSE[:3, 2] + 0.05 * BRICK_POSE[:3, 0]
    return up


def test_a_known_shape_that_leans_in_its_grid_is_stood_up(pipeline: Pipeline) -> None:
    result = pipeline.predict(brick(up=leaning()))
    expected = leaning() / np.linalg.norm(leaning())
    np.testing.assert_allclose(result.grid.camera_from_grid[:3, 2], expected, atol=1e-9)
    volume_m3 = result.reconstruction.sum() * result.grid.pitch_m**3
    assert volume_m3 == pytest.approx(BRICK.sum() * BRICK_PITCH_M**3, rel=0.05)


@pytest.mark.parametrize("up", [None, leaning()])
def test_a_known_shape_moves_with_its_push(pipeline: Pipeline, up: Vector3 | None) -> None:
    result = pipeline.predict(brick(up=up))
    load = result.loads[0]
    direction = result.grid.camera_from_grid[:3, :3].T @ BRICK_POSE[:3, 0]
    assert direction @ load.displacement_m[:, load.deformed].mean(axis=1) > 0.0


def test_a_known_shape_has_no_pixels(pipeline: Pipeline) -> None:
    with pytest.raises(InvalidRequest) as caught:
        pipeline.predict(brick(Load(np.array([0.0, 0.0, 1.0]), contact_px=(3.0, 4.0))))
    assert caught.value.field == "loads[0].contact_px"


def test_a_question_asked_twice_has_one_answer_even_with_samples(pipeline: Pipeline) -> None:
    first, second = (pipeline.predict(brick(uncertainty_samples=2)).loads[0] for _ in range(2))
    np.testing.assert_array_equal(first.probability, second.probability)
    np.testing.assert_array_equal(first.displacement_m, second.displacement_m)


def test_the_threshold_asked_for_is_the_one_that_cuts(pipeline: Pipeline) -> None:
    loose, strict = (pipeline.predict(brick(threshold=cut)).loads[0] for cut in (0.1, 0.9))
    assert strict.deformed.sum() < loose.deformed.sum()
    assert not (strict.deformed & ~loose.deformed).any()
    np.testing.assert_array_equal(loose.deformed, loose.probability > 0.1)


@pytest.mark.parametrize("force_n", [1e-3, 2.0, 1e6])
def test_a_body_that_reaches_the_walls_of_its_grid_is_flagged(pipeline: Pipeline, force_n: float) -> None:
    load = pipeline.predict(brick(brick_push(force_n))).loads[0]
    body = load.deformed
    walls = body[0].any() or body[-1].any() or body[:, 0].any() or body[:, -1].any() or body[:, :, -1].any()
    assert ("leaves_grid" in load.flags) == bool(walls)
    if force_n < 1.0:
        assert not load.flags


def test_a_push_that_crumples_thin_walls_is_flagged_and_a_gentle_one_is_not(pipeline: Pipeline) -> None:
    x, y, z = np.indices((64, 64, 64)) - np.array([31.5, 31.5, 0.0])[:, None, None, None]
    radius = np.sqrt(x**2 + y**2)
    cup = (radius < 24) & ((radius > 22) | (z < 3)) & (z < 44)
    contact_m = np.array([(31.5 + 23.5) / 64, 32 / 64, 38 / 64])
    loads = [Load(np.array([-force_n, 0.0, 0.0]), contact_m) for force_n in (1.0, 1000.0)]
    source = KnownShape(pack_bits(cup).tobytes(), 1 / 64, np.eye(4))
    gentle, hard = pipeline.predict(DeformRequest(source, Material(1e5, 0.49), tuple(loads))).loads
    assert "not_balanced" not in gentle.flags
    assert "not_balanced" in hard.flags


# --- asked again ---


@pytest.fixture
def keeping(models: Models) -> Pipeline:
    return Pipeline(models.reconstruction, models.deformation, kept=Reconstructions(16 * 2**20, 60.0))


def same(one: DeformResult, other: DeformResult) -> None:
    """Bit for bit, but for the time it took."""
    for name in ("observed", "reconstruction", "reconstruction_probability"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_array_equal(one.grid.camera_from_grid, other.grid.camera_from_grid)
    assert (one.grid.pitch_m, one.flags) == (other.grid.pitch_m, other.flags)
    for first, second in zip(one.loads, other.loads, strict=True):
        for name in ("deformed", "probability", "displacement_m"):
            np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
        assert first.max_displacement_m == second.max_displacement_m
        assert (first.load_number, first.flags) == (second.load_number, second.flags)


def again_of(answer: DeformResult) -> EarlierReconstruction:
    assert answer.reconstruction_id is not None
    return EarlierReconstruction(answer.reconstruction_id)


def test_asked_again_by_its_id_it_answers_the_same_to_contacts_in_metres_and_in_pixels(
    keeping: Pipeline, scene: TableScene
) -> None:
    contact_m = front(scene).contact_m
    assert contact_m is not None
    pixels, _ = project(contact_m[None].astype(np.float32), CAMERA)
    by_pixel = Load(force_n=front(scene).force_n, contact_px=(float(pixels[0, 0]), float(pixels[0, 1])))
    asked = request(scene, front(scene), by_pixel)
    first = keeping.predict(asked)
    again = keeping.predict(replace(asked, source=again_of(first)))
    same(first, again)
    assert again.reconstruction_id == first.reconstruction_id
    assert set(again.timing_ms) == {"deform", "total"}
    # Other loads and another material are those of a question asked anew.
    harder = replace(asked, loads=(front(scene, 6.0),), material=Material(2e5, 0.3))
    same(keeping.predict(harder), keeping.predict(replace(harder, source=again_of(first))))


def test_what_is_kept_is_counted_whole(models: Models, scene: TableScene) -> None:
    """Every array of a kept body, and none of them a view that holds more memory than it shows."""
    kept = Reconstructions[Body](16 * 2**20, 60.0)
    answered = Pipeline(models.reconstruction, models.deformation, kept=kept).predict(request(scene))
    body = kept.find(again_of(answered).reconstruction_id)
    assert body.crop is not None
    held = [*vars(body).values(), *vars(body.crop()).values()]
    arrays = list({id(value): value for value in held if isinstance(value, np.ndarray)}.values())
    assert len(arrays) >= 5
    assert not [array for array in arrays if array.base is not None and array.base.nbytes > array.nbytes]
    assert kept.nbytes == sum(array.nbytes for array in arrays)


def test_a_known_shape_is_asked_again_too_but_has_no_pixels(keeping: Pipeline) -> None:
    first = keeping.predict(brick())
    source = again_of(first)
    same(first, keeping.predict(replace(brick(), source=source)))
    with pytest.raises(InvalidRequest, match="without an image"):
        keeping.predict(replace(brick(Load(np.array([0.0, 0.0, 1.0]), contact_px=(1.0, 1.0))), source=source))


def test_where_nothing_is_kept_there_is_no_id(pipeline: Pipeline, answer: DeformResult) -> None:
    assert answer.reconstruction_id is None
    with pytest.raises(ReconstructionGone):
        pipeline.predict(replace(brick(), source=EarlierReconstruction("0" * 32)))


def test_a_known_shape_is_smoothed_in_its_own_grid(pipeline: Pipeline) -> None:
    """What is looked up after a push knows the surface as the given voxels tell it, not as those of the reply do."""
    given = brick(up=leaning()).source
    assert isinstance(given, KnownShape)
    body, _ = pipeline._place(given, (), Stopwatch())
    assert body.inside is not None and not body.inside.probable
    smooth = body.inside.values
    between = (smooth > 0.02) & (smooth < 0.98)
    again = smoothed(body.occupancy)
    assert np.abs(smooth - again)[between].max() > 0.02
    # Both tell the same body but for its edges, which smoothing rounds.
    assert ((smooth > 0.5) ^ body.occupancy).sum() < 0.05 * body.occupancy.sum()
    assert body.nbytes > smooth.nbytes + body.probability.nbytes
