"""OctoMap's binary trees (`.bt`), which MoveIt and the navigation stacks of ROS read as obstacles.

Source: Hornung et al., OctoMap, Autonomous Robots 34 (2013) 189; AbstractOccupancyOcTree.cpp and
OccupancyOcTreeBase.hxx of OctoMap 1.10 for the layout. The tree is 16 levels deep; a leaf's key is its coordinate
divided by the resolution, rounded down, plus 2¹⁵. A node with children is two bytes, two bits a child: 01 occupied,
10 free, 11 with children, 00 unknown, the first bit the lower one. Children follow their parent, depth first.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Int64

DEPTH = 16
CENTRE_KEY = 1 << (DEPTH - 1)

_OCCUPIED, _INNER = 0b10, 0b11  # as numbers, where the lower bit comes first
_SOLID = 8
"""Children of a node that is occupied as a whole."""


def encode_octomap(cells: Int64[np.ndarray, "n 3"], resolution_m: float) -> bytes:
    """A `.bt` file of occupied cells; everything else stays unknown.

    Args:
        cells: Indices of cells: cell (i, j, k) has its centre at ((i+½), (j+½), (k+½)) · resolution. Each once.
        resolution_m: Edge of a cell.

    Raises:
        ValueError: A cell lies beyond the 2¹⁵ cells that a tree reaches in each direction.
    """
    keys = cells + CENTRE_KEY
    if len(keys) and (keys.min() < 0 or keys.max() >= 2 * CENTRE_KEY):
        raise ValueError(f"an OctoMap of {resolution_m:g} m reaches {CENTRE_KEY * resolution_m:g} m from its origin")
    levels = _levels(keys)
    body = bytearray()
    nodes = _write(levels, (0, 0, 0), 0, body) if len(keys) else 0
    header = (
        "# Octomap OcTree binary file\n# (feel free to add / change comments, but leave the first line as it is!)\n#\n"
        f"id OcTree\nsize {nodes}\nres {resolution_m!r}\ndata\n"
    )
    return header.encode("ascii") + bytes(body)


Node = tuple[int, int, int]


def _levels(keys: np.ndarray) -> list[dict[Node, int]]:
    """Of each level, root first, the code of every node that is not empty; a node of eight full children is full."""
    levels: list[dict[Node, int]] = [{(int(x), int(y), int(z)): _OCCUPIED for x, y, z in keys}]
    for _ in range(DEPTH):
        full: dict[Node, int] = {}
        for (x, y, z), code in levels[0].items():
            parent = (x >> 1, y >> 1, z >> 1)
            full[parent] = full.get(parent, 0) + (code == _OCCUPIED)
        levels.insert(0, {node: _OCCUPIED if count == _SOLID else _INNER for node, count in full.items()})
    # A root without children could not be written down.
    levels[0] = dict.fromkeys(levels[0], _INNER)
    return levels


def _write(levels: list[dict[Node, int]], node: Node, level: int, body: bytearray) -> int:
    """Write the children of an inner node, and theirs; returns the number of nodes, itself included."""
    children = [(child, levels[level + 1].get(child, 0)) for child in _children(node)]
    codes = sum(code << (2 * place) for place, (_, code) in enumerate(children))
    body += codes.to_bytes(2, "little")
    nodes = 1
    for child, code in children:
        if code == _INNER:
            nodes += _write(levels, child, level + 1, body)
        elif code:
            nodes += 1
    return nodes


def _children(node: Node) -> Iterator[Node]:
    x, y, z = node
    for place in range(8):
        yield 2 * x + (place & 1), 2 * y + (place >> 1 & 1), 2 * z + (place >> 2)
