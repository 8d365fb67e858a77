"""One page: from a frame to what the object will look like when pushed."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64

from service.core.alignment import body_grid, body_grid_free, resample
from service.core.arrays import GRID_SIZE, DepthImage, Occupancy, Probability, Vector3
from service.core.camera import Intrinsics, pixel_to_point
from service.core.condition import POISSON_RATIO_MAX, Condition, encode_condition, load_number
from service.core.contact import snap_contact, surface_centres
from service.core.covering import cover
from service.core.depth import decode_depth, decode_mask
from service.core.depth_crop import DepthCrop, crop_around
from service.core.displacement import Field
from service.core.errors import InvalidRequest
from service.core.grids import Grid
from service.core.limits import DEFAULT_LIMITS, FrameLimits
from service.core.lookup import Inside
from service.core.materials import Material
from service.core.messages import (
    DeformRequest,
    DeformResult,
    EarlierReconstruction,
    KnownShape,
    Load,
    LoadResult,
    Observation,
)
from service.core.motion import motion
from service.core.segmentation import segment
from service.core.shapes import decode_shape, in_own_voxels
from service.core.smoothing import smoothed
from service.core.spread import Spread
from service.core.voxels import voxelize, voxelize_points
from service.inference.deformation import DeformationModel
from service.inference.reconstruction import ReconstructionModel
from service.inference.spare_cores import Once
from service.reconstructions import Reconstructions

KNOWN_SHAPE_THRESHOLD = 0.5
"""A known shape is binary: half-way is its surface whatever the networks' thresholds are."""

IMAGE_UP = np.array([0.0, -1.0, 0.0])
"""Stands in for `up` where neither a plane nor the robot tells: the top of the image."""


@dataclass(frozen=True)
class Body:
    """The object before the push, in the grid that it is answered in.

    Attributes:
        grid: The body grid, or a known shape's own; every grid of the reply shares it.
        observed: Voxels with a measured point; None for a known shape.
        probability: Occupancy probability.
        occupancy: The body.
        flags: What the robot should know about it.
        crop: The depth image around it, in which later contacts are looked up, once it is asked for; None for a known
            shape.
        inside: What the deformed body is looked up in, where that tells more than the voxels of `occupancy`: the
            probability of a reconstruction, whose doubt so goes on into the answer, or the smoothed occupancy of a
            known shape that is not answered in its own grid.
    """

    grid: Grid
    observed: Occupancy | None
    probability: Probability
    occupancy: Occupancy
    flags: frozenset[str]
    crop: Once[DepthCrop] | None = None
    inside: Inside | None = None

    @cached_property
    def surface_m(self) -> Float64[np.ndarray, "axis=3 n"]:
        """Where a load may touch it, see `surface_centres`."""
        return surface_centres(self.occupancy, self.grid)

    @property
    def nbytes(self) -> int:
        """Memory of its arrays."""
        depth_m = None if self.crop is None else self.crop().depth_m
        inside = None if self.inside is None or self.inside.values is self.probability else self.inside.values
        arrays = (self.observed, self.probability, self.occupancy, self.surface_m, depth_m, inside)
        return sum(array.nbytes for array in arrays if array is not None)


@dataclass(frozen=True)
class Question:
    """One load, ready for the network.

    Attributes:
        condition: None for a zero force, which moves nothing.
        load_number: F/(E L²).
        flags: What the robot should know about the answer.
    """

    condition: Condition | None
    load_number: float
    flags: frozenset[str]


class Stopwatch:
    """Wall time of each stage."""

    def __init__(self) -> None:
        self.timing_ms: dict[str, float] = {}
        self._started = time.perf_counter()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        started = time.perf_counter()
        yield
        self.timing_ms[name] = self.timing_ms.get(name, 0.0) + (time.perf_counter() - started) * 1e3

    def finish(self) -> dict[str, float]:
        return {**self.timing_ms, "total": (time.perf_counter() - self._started) * 1e3}


class Pipeline:
    """Decode, segment, voxelize, reconstruct, align, encode the condition, deform.

    Args:
        reconstruction: From a view to a full shape.
        deformation: From a full shape and loads to deformed shapes.
        limits: What is decoded at all.
        kept: Where reconstructions are kept to be asked again; none are where it is None.
    """

    def __init__(
        self,
        reconstruction: ReconstructionModel,
        deformation: DeformationModel,
        limits: FrameLimits = DEFAULT_LIMITS,
        kept: Reconstructions[Body] | None = None,
    ) -> None:
        self._reconstruction = reconstruction
        self._deformation = deformation
        self._limits = limits
        self._kept = kept or Reconstructions(max_bytes=0, lifetime_s=0.0)

    def predict(self, request: DeformRequest) -> DeformResult:
        """Answer one request.

        Raises:
            PhysNetError: A leaf of the tree in `service.core.errors`, naming the field at fault.
        """
        with self._deformation.spare.answering():
            return self._answer(request)

    def _answer(self, request: DeformRequest) -> DeformResult:
        watch = Stopwatch()
        match request.source:
            case EarlierReconstruction() as earlier:
                body = self._kept.find(earlier.reconstruction_id)
                contacts = _contacts_again(body, request.loads)
            case KnownShape():
                body, contacts = self._place(request.source, request.loads, watch)
            case Observation():
                body, contacts = self._reconstruct(request.source, request.loads, request.threshold, watch)
        loads = self._deform(body, contacts, request, watch)
        if isinstance(request.source, EarlierReconstruction):
            reconstruction_id: str | None = request.source.reconstruction_id
        else:
            reconstruction_id = self._kept.keep(body, body.nbytes)
        manifest = self._deformation.manifest
        return DeformResult(
            grid=body.grid,
            observed=body.observed,
            reconstruction=body.occupancy,
            reconstruction_probability=body.probability,
            loads=loads,
            flags=body.flags,
            model_name=manifest.name,
            model_version=manifest.version,
            reconstruction_id=reconstruction_id,
            timing_ms=watch.finish(),
        )

    def _reconstruct(
        self, source: Observation, loads: tuple[Load, ...], threshold: float | None, watch: Stopwatch
    ) -> tuple[Body, list[Vector3]]:
        """From one depth frame to a full body in its body grid, and the contacts in the camera frame."""
        camera = source.intrinsics
        with watch.stage("decode"):
            depth_m = decode_depth(
                source.depth.encoding, source.depth.data, source.depth.unit_m, camera.width, camera.height, self._limits
            )
            mask = None
            if source.mask is not None:
                mask = decode_mask(source.mask.encoding, source.mask.data, camera.width, camera.height, self._limits)
        with watch.stage("segment"):
            contacts = [_contact(load, depth_m, camera, f"loads[{i}].contact_px") for i, load in enumerate(loads)]
            found = segment(
                depth_m, camera, mask, source.up, contact_m=contacts[0] if contacts else None, roi=source.roi
            )
            crop = Once(lambda: crop_around(found.box, depth_m, camera))
        with watch.stage("voxelize"):
            up = IMAGE_UP if found.up is None else found.up
            offset_m = found.support.offset_m if found.support else -float((found.points @ up.astype(np.float32)).min())
            view = voxelize(found.points, depth_m, camera, up, offset_m)
        with watch.stage("reconstruct"):
            seen = self._reconstruction(view)
        with watch.stage("align"):
            cut = self._reconstruction.manifest.threshold if threshold is None else threshold
            align = body_grid if found.support else body_grid_free
            grid = align(cover(seen > cut, view.observed), view.grid)
            probability = resample(seen, view.grid, grid)
            observed = voxelize_points(found.points, grid)
            occupancy = cover(probability > cut, observed)
            inside = Inside(probability, probable=True)
        return Body(grid, observed, probability, occupancy, found.flags, crop, inside), contacts

    def _place(self, source: KnownShape, loads: tuple[Load, ...], watch: Stopwatch) -> tuple[Body, list[Vector3]]:
        """A known shape in its own grid or, where that does not serve, its body grid; contacts in the camera frame."""
        contacts = [_contact_in_metres(load, f"loads[{i}].contact_px") for i, load in enumerate(loads)]
        with watch.stage("decode"):
            given, given_grid = decode_shape(source)
        with watch.stage("align"):
            if (own := in_own_voxels(given, given_grid, source.up)) is not None:
                occupancy, grid = own
                return Body(grid, None, occupancy.astype(np.float32), occupancy, frozenset()), contacts
            grid = body_grid(given, given_grid, up=source.up, on_floor=False)
            probability = resample(given.astype(np.float32), given_grid, grid)
            inside = Inside(resample(smoothed(given), given_grid, grid), probable=False)
        occupancy = probability > KNOWN_SHAPE_THRESHOLD
        return Body(grid, None, probability, occupancy, frozenset(), inside=inside), contacts

    def _deform(
        self, body: Body, contacts: list[Vector3], request: DeformRequest, watch: Stopwatch
    ) -> tuple[LoadResult, ...]:
        """Every load on its own, all in one batch of the network."""
        with watch.stage("deform"):
            asked = Once(lambda: self._questions(body, contacts, request))
            if any(load.force_n.any() for load in request.loads):
                later = () if body.crop is None else (body.crop,)
                self._deformation.prepare(
                    body.occupancy, request.material.poisson_ratio, body.inside, soon=(asked,), later=later
                )
            questions = asked()
            conditions = [question.condition for question in questions if question.condition is not None]
            answers: Iterator[LoadResult] = iter(())
            if conditions:
                deformation = self._deformation(
                    body.occupancy, conditions, request.uncertainty_samples, inside=body.inside
                )
                threshold = self._deformation.manifest.threshold if request.threshold is None else request.threshold
                moving = [question for question in questions if question.condition is not None]

                def moved(i: int, _: Spread) -> LoadResult:
                    # One load alone is not shared out: the other thread would wake later than this one is done.
                    question = moving[i]
                    if not deformation.balanced[i]:
                        question = replace(question, flags=question.flags | {"not_balanced"})
                    return _moved(body, question, deformation.probability[i], deformation.field[i], threshold)

                answers = iter(self._deformation.spare.each(moved, len(moving)))
            return tuple(
                _unmoved(body, question) if question.condition is None else next(answers) for question in questions
            )

    def _questions(self, body: Body, contacts: list[Vector3], request: DeformRequest) -> list[Question]:
        return [
            self._question(body, load, contact, request.material, f"loads[{i}]")
            for i, (load, contact) in enumerate(zip(request.loads, contacts, strict=True))
        ]

    def _question(self, body: Body, load: Load, contact_m: Vector3, material: Material, field: str) -> Question:
        """Where the load meets the body, and the condition in its grid."""
        contact_m, snapped = snap_contact(contact_m, body.surface_m, body.grid, f"{field}.contact_m")
        flags = {"contact_snapped"} if snapped else set()
        if material.poisson_ratio > POISSON_RATIO_MAX:
            flags.add("poisson_ratio_clamped")
        force_n = float(np.linalg.norm(load.force_n))
        if force_n == 0.0:
            return Question(None, 0.0, frozenset(flags))
        condition = encode_condition(
            body.grid, contact_m, load.force_n, material.young_modulus_pa, material.poisson_ratio, load.patch_radius_m
        )
        if self._deformation.outside_training_range(condition):
            flags.add("outside_training_range")
        return Question(condition, load_number(force_n, material.young_modulus_pa, body.grid.edge_m), frozenset(flags))


def _contact(load: Load, depth_m: DepthImage, camera: Intrinsics, field: str) -> Vector3:
    """The contact in the camera frame, looked up in the depth image where it was named by its pixel."""
    if load.contact_m is not None:
        return load.contact_m
    if load.contact_px is None:
        raise InvalidRequest("A load needs a contact.", field=field, expected="contact_m or contact_px")
    return pixel_to_point(*load.contact_px, depth_m, camera, field=field)


def _contact_in_metres(load: Load, field: str) -> Vector3:
    """The contact of a load on a body that was never seen."""
    if load.contact_m is None:
        raise InvalidRequest(
            "A known shape comes without an image: give the contact in metres.", field=field, expected="contact_m"
        )
    return load.contact_m


def _contacts_again(body: Body, loads: tuple[Load, ...]) -> list[Vector3]:
    """The contacts in the camera frame, on a body that was reconstructed before."""
    contacts = []
    for i, load in enumerate(loads):
        if load.contact_px is not None and body.crop is not None:
            contacts.append(body.crop().point(*load.contact_px, f"loads[{i}].contact_px"))
        else:
            contacts.append(_contact_in_metres(load, f"loads[{i}].contact_px"))
    return contacts


def _unmoved(body: Body, question: Question) -> LoadResult:
    """The answer to a zero force."""
    return LoadResult(
        deformed=body.occupancy,
        probability=body.probability,
        moved_m=np.zeros((3, np.count_nonzero(body.occupancy)), np.float32),
        max_displacement_m=0.0,
        mean_displacement_m=0.0,
        load_number=0.0,
        flags=question.flags,
    )


def _moved(
    body: Body, question: Question, probability: Probability, field: Field, threshold: float
) -> LoadResult:
    """The network's answer in metres."""
    moved = motion(field, body.occupancy, probability, threshold, body.grid.edge_m)
    deformed = moved.deformed
    sides = (deformed[:: GRID_SIZE - 1], deformed[:, :: GRID_SIZE - 1], deformed[:, :, -1])
    flags = question.flags | ({"leaves_grid"} if any(side.any() for side in sides) else set())
    return LoadResult(
        deformed=deformed,
        probability=probability,
        moved_m=moved.moved_m,
        max_displacement_m=moved.max_m,
        mean_displacement_m=moved.mean_m,
        load_number=question.load_number,
        flags=flags,
    )
