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
        np.linalg.LinAlgError: A pivot block is not positive definite.
    """

    def __init__(
        self, diagonal: Sequence[Float32[np.ndarray, "_ _"]], below: Sequence[Float32[np.ndarray, "_ _"]]
    ) -> None:
        self._inverses = [invert_spd(diagonal[0])]
        self._transfers: list[Float32[np.ndarray, "_ _"]] = []
        for block, coupling in zip(diagonal[1:], below, strict=True):
            transfer = coupling @ self._inverses[-1]
            self._transfers.append(transfer)
            self._inverses.append(invert_spd(block - transfer @ coupling.T))
        self._ends = np.cumsum([len(block) for block in diagonal])[:-1]

    def solve(self, right: Float32[np.ndarray, "dof loads"]) -> Float32[np.ndarray, "dof loads"]:
        """Solutions for any number of right-hand sides."""
        parts: list[Float32[np.ndarray, "_ loads"]] = list(np.split(right, self._ends))
        for k, transfer in enumerate(self._transfers):
            parts[k + 1] = parts[k + 1] - transfer @ parts[k]
        parts[-1] = self._inverses[-1] @ parts[-1]
        for k in range(len(parts) - 2, -1, -1):
            parts[k] = self._inverses[k] @ parts[k] - self._transfers[k].T @ parts[k + 1]
        return np.concatenate(parts)


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
