"""NumPy façade of the reconstruction network."""

from __future__ import annotations

import onnxruntime

from service.core.arrays import Probability
from service.core.manifest import Manifest
from service.core.voxels import VoxelView, rule_out, states_of


class ReconstructionModel:
    """From what a view says about each voxel to the probability that it belongs to the object."""

    def __init__(self, session: onnxruntime.InferenceSession, manifest: Manifest) -> None:
        self._session = session
        self.manifest = manifest

    def __call__(self, view: VoxelView) -> Probability:
        """Occupancy probability of every voxel of the view grid.

        What was measured overrules the network: a voxel that a ray went through is empty, and so is one above all that
        was seen of the object, see `VoxelView.layers`.
        """
        (probability,) = self._session.run(["probability"], {"view": states_of(view)[None]})
        result: Probability = probability[0]
        rule_out(result, view)
        return result
