"""What a robot gets back: grids with their pose, and what one does with them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypeAlias, TypeVar

import numpy as np

from service.client.displacement import Configuration, DisplacementField, displacement_at
from service.client.question import Earlier
from service.core.arrays import Occupancy, Points, Probability
from service.core.grids import Grid, transform_points
from service.core.surface_mesh import Faces, surface_mesh

Found = TypeVar("Found")
Layer: TypeAlias = Literal["observed", "reconstruction", "deformed"]


class NotInReply(AttributeError):
    """The reply does not carry this: it was not asked for."""


@dataclass(frozen=True)
class Mesh:
    """A closed surface.

    Attributes:
        vertices_m: Camera frame, metres.
        faces: Three vertices each, counter-clockwise seen from outside.
    """

    vertices_m: Points
    faces: Faces

    def __repr__(self) -> str:
        return f"<Mesh: {len(self.vertices_m)} vertices, {len(self.faces)} faces>"


@dataclass(frozen=True)
class PushResult:
    """The answer to one push. Grids that were not asked for are None.

    Attributes:
        grid: Where the grids sit.
        occupancy: The deformed body.
        probability: Behind it, in steps of 1/255.
        displacement: At each voxel of the deformed body, how far the material now there has come.
        max_displacement_m, mean_displacement_m: Over the deformed body.
        load_number: F/(E L²), L the edge of the grid.
        flags: What to know about this answer.
    """

    grid: Grid
    occupancy: Occupancy | None
    probability: Probability | None
    displacement: DisplacementField | None
    max_displacement_m: float
    mean_displacement_m: float
    load_number: float
    flags: frozenset[str]

    def __repr__(self) -> str:
        return f"<PushResult: {self._said()}>"

    def _said(self) -> str:
        return f"moves by {1e3 * self.max_displacement_m:.1f} mm at most" + _flagged(self.flags)

    @property
    def deformed(self) -> Occupancy:
        """The deformed body, [x, y, z].

        Raises:
            NotInReply: It was not asked for.
        """
        return _need(self.occupancy, "deformed")

    @property
    def displacement_m(self) -> np.ndarray | None:
        """`displacement` as a field, 3 × 64³: grid axes, half precision as it travelled; zero outside the body."""
        return None if self.displacement is None else self.displacement.grid_m

    @property
    def moved_m(self) -> np.ndarray:
        """`displacement` of each voxel of `deformed`, 3 × n in the order of `points_camera()`; grid axes.

        Raises:
            NotInReply: `displacement` or `deformed` was not asked for.
        """
        _need(self.occupancy, "deformed")
        return _need(self.displacement, "displacement").at_voxels_m

    def points_camera(self) -> Points:
        """Centres of the deformed body's voxels, camera frame, metres."""
        return _centres(self.deformed, self.grid)

    def mesh(self) -> Mesh:
        """The surface of the deformed body."""
        return Mesh(*surface_mesh(self.deformed, self.grid.camera_from_grid, self.grid.pitch_m))

    def displacement_at(self, points_m: np.ndarray, configuration: Configuration = "rest") -> Points:
        """How far the material at points moves; camera frame, metres; NaN where there is no body.

        Args:
            points_m: n × 3, camera frame, metres; NaN, as pixels without a reading become, stays NaN.
            configuration: `rest`: the points are places of the body before the push, as the camera sees it now;
                `deformed`: places where the body is after it.

        Raises:
            NotInReply: `displacement` was not asked for.
        """
        field_m = _need(self.displacement, "displacement").grid_m
        points = np.asarray(points_m, np.float32).reshape(-1, 3)
        places = np.isfinite(points).all(axis=1)
        found = displacement_at(transform_points(self.grid.grid_from_camera, points[places]), self.deformed, field_m,
                                self.grid.pitch_m, configuration)  # fmt: skip
        moved = np.full_like(points, np.nan)
        moved[places] = found @ self.grid.camera_from_grid[:3, :3].T.astype(np.float32)
        return moved


@dataclass(frozen=True)
class Result:
    """The answer to one frame: the body, and what each push makes of it (`result[i]`).

    `deformed`, `mesh()` and their kind are those of the first push.

    Attributes:
        request_id: What the service's log calls the request.
        model: Name and version of the deformation model.
        grid: Where every grid sits: 64³ voxels, z up, floor on the support.
        seen: Voxels that the camera saw; None for a known shape.
        body: The full shape before any push.
        body_probability: Behind it.
        pushes: In the order of the request.
        flags: What to know about the frame.
        timing_ms: Wall time of each stage in the service.
        reconstruction_id: Asks the service for the same body again; None where it keeps none.
    """

    request_id: str
    model: tuple[str, str]
    grid: Grid
    seen: Occupancy | None
    body: Occupancy | None
    body_probability: Probability | None
    pushes: tuple[PushResult, ...]
    flags: frozenset[str]
    timing_ms: dict[str, float] = field(default_factory=dict)
    reconstruction_id: str | None = None

    def __repr__(self) -> str:
        """One line: the grids themselves would fill screens."""
        said = "; ".join(push._said() for push in self.pushes)
        return f"<Result of {' '.join(self.model)}: {said or 'no push'}{_flagged(self.flags)}>"

    def __getitem__(self, push: int) -> PushResult:
        return self.pushes[push]

    def __len__(self) -> int:
        return len(self.pushes)

    def __iter__(self) -> Iterator[PushResult]:
        return iter(self.pushes)

    @property
    def earlier(self) -> Earlier:
        """This body, to be asked about again without its frame: `client.deform(result.earlier, push=…)`.

        Raises:
            NotInReply: The service keeps none.
        """
        if self.reconstruction_id is None:
            raise NotInReply("the service keeps no reconstructions: send the frame again")
        return Earlier(self.reconstruction_id)

    @property
    def observed(self) -> Occupancy:
        """Voxels that the camera saw, [x, y, z].

        Raises:
            NotInReply: `reconstruction` was not asked for, or the shape was known.
        """
        return _need(self.seen, "reconstruction")

    @property
    def reconstruction(self) -> Occupancy:
        """The full body before any push, [x, y, z].

        Raises:
            NotInReply: It was not asked for.
        """
        return _need(self.body, "reconstruction")

    @property
    def deformed(self) -> Occupancy:
        """The body after the first push, [x, y, z]."""
        return self[0].deformed

    @property
    def displacement_m(self) -> np.ndarray:
        """Displacement of the first push, 3 × 64³, grid axes."""
        return _need(self[0].displacement, "displacement").grid_m

    @property
    def max_displacement_m(self) -> float:
        """Largest displacement of the first push."""
        return self[0].max_displacement_m

    def occupancy(self, layer: Layer = "deformed", push: int = 0) -> Occupancy:
        """Voxels of a layer."""
        return self[push].deformed if layer == "deformed" else getattr(self, layer)

    def points_camera(self, layer: Layer = "deformed", push: int = 0) -> Points:
        """Centres of a layer's voxels, camera frame, metres."""
        return _centres(self.occupancy(layer, push), self.grid)

    def mesh(self, layer: Layer = "deformed", push: int = 0) -> Mesh:
        """The surface of a layer."""
        return Mesh(*surface_mesh(self.occupancy(layer, push), self.grid.camera_from_grid, self.grid.pitch_m))

    def displacement_at(self, points_m: np.ndarray, configuration: Configuration = "rest", push: int = 0) -> Points:
        """See `PushResult.displacement_at`."""
        return self[push].displacement_at(points_m, configuration)

    def save(self, path: str | Path, layer: Layer = "deformed", push: int = 0) -> Path:
        """Write a file; its suffix says which kind. See `service.client.formats.files`.

        Args:
            path: `.npz` (everything), `.ply` and `.glb` (surfaces), `.bt` (OctoMap), in the camera frame, metres;
                `.binvox`, which knows no rotation, in the grid's own frame.
            layer: Which body a file of one body holds.
            push: After which push.

        Raises:
            ValueError: Another suffix.
            NotInReply: The layer was not asked for.
        """
        from service.client.formats.files import save

        return save(self, Path(path), layer, push)


def _flagged(flags: frozenset[str]) -> str:
    return f" [{', '.join(sorted(flags))}]" if flags else ""


def _need(found: Found | None, output: str) -> Found:
    if found is None:
        raise NotInReply(f"the reply does not carry this: ask for {output!r} in `outputs`")
    return found


def _centres(occupancy: Occupancy, grid: Grid) -> Points:
    centres = (np.argwhere(occupancy).astype(np.float32) + np.float32(0.5)) * np.float32(grid.pitch_m)
    return transform_points(grid.camera_from_grid, centres)
