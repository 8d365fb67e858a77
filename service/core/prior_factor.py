"""Cholesky's method for a block tridiagonal matrix, in matrix products only.

NumPy has no triangular solve, and its small inverses are slow; its single-precision matrix product is not. So every
pivot block is inverted by halves, and a solution is two products a block.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float32

_LEAF = 36
"""Blocks up to this size are inverted by OpenCV's Cholesky; measured best on an AVX-512 core between 24 and 48."""


class BlockTridiagonal:
    """The factor of a symmetric positive definite matrix of blocks D_k on and B_k (row k + 1, column k) below the
    diagonal.

    S_0 = D_0, T_k = B_k S_k⁻¹, S_{k+1} = D_{k+1} − T_k B_kᵀ. Source: Golub and Van Loan, Matrix Computations (2013),
    section 4.5.1.

    Raises:
        np.linalg.LinAlgError: A pivot block is not positive definite, or not in single precision.
    """

    def __init__(
        self, diagonal: Sequence[Float32[np.ndarray, "_ _"]], below: Sequence[Float32[np.ndarray, "_ _"]]
    ) -> None:
        inverse = invert_spd(diagonal[0])
        self._forward: list[Float32[np.ndarray, "_ _"]] = []  # T_k
        self._backward: list[Float32[np.ndarray, "_ _"]] = []  # S_k⁻¹ beside −T_kᵀ
        for block, coupling in zip(diagonal[1:], below, strict=True):
            transfer = coupling @ inverse
            self._forward.append(transfer)
            self._backward.append(np.concatenate([inverse, -transfer.T], axis=1))
            inverse = invert_spd(block - transfer @ coupling.T)
        if not np.isfinite(inverse).all():
            raise np.linalg.LinAlgError("the stiffness matrix is too close to a singular one for single precision")
        self._last = inverse
        self._starts = [0, *np.cumsum([len(block) for block in diagonal]).tolist()]

    def solve(self, right: Float32[np.ndarray, "dof loads"]) -> Float32[np.ndarray, "dof loads"]:
        """Solutions for any number of right-hand sides."""
        result, starts = right.copy(), self._starts
        for k, transfer in enumerate(self._forward):
            result[starts[k + 1] : starts[k + 2]] -= transfer @ result[starts[k] : starts[k + 1]]
        result[starts[-2] :] = self._last @ result[starts[-2] :]
        for k in range(len(self._backward) - 1, -1, -1):
            result[starts[k] : starts[k + 1]] = self._backward[k] @ result[starts[k] : starts[k + 2]]
        return result


def invert_spd(matrix: Float32[np.ndarray, "n n"]) -> Float32[np.ndarray, "n n"]:
    """Inverse of a symmetric positive definite matrix by halves.

    Raises:
        np.linalg.LinAlgError: It is not positive definite.
    """
    n = len(matrix)
    if n <= _LEAF:
        determinant, inverse = cv2.invert(np.ascontiguousarray(matrix), flags=cv2.DECOMP_CHOLESKY)
        if determinant == 0.0:
            raise np.linalg.LinAlgError("the stiffness matrix is not positive definite")
        return np.asarray(inverse, np.float32)
    h = n // 2
    first = invert_spd(matrix[:h, :h])
    transfer = matrix[h:, :h] @ first
    last = invert_spd(matrix[h:, h:] - transfer @ matrix[h:, :h].T)
    result = np.empty_like(matrix)
    corner = last @ transfer
    result[h:, h:] = last
    result[h:, :h] = -corner
    result[:h, h:] = -corner.T
    result[:h, :h] = first + transfer.T @ corner
    return result
