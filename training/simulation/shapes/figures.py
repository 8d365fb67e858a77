"""Families of soft toys: smoothly joined ellipsoids and capsules with heads, ears and limbs."""

from __future__ import annotations

import math

from training.simulation.shapes.field import Field, SmoothUnion
from training.simulation.shapes.primitives import Capsule, Ellipsoid, Sphere
from training.simulation.shapes.shape import Shape, stand
from training.simulation.shapes.solids import Rng


def plush(rng: Rng, thin: bool) -> Shape:
    """A sitting or standing teddy."""
    belly = Ellipsoid((rng.uniform(0.3, 0.38), rng.uniform(0.26, 0.34), rng.uniform(0.36, 0.45)))
    head_radius = rng.uniform(0.24, 0.31)
    head_height = belly.semi_axes[2] + head_radius * rng.uniform(0.6, 0.8)
    limb = rng.uniform(0.09, 0.12) if thin else rng.uniform(0.18, 0.21)
    ear = rng.uniform(0.08, 0.11) if thin else rng.uniform(0.18, 0.2)
    parts: list[Field] = [belly, Sphere(head_radius).shift(y=-0.03, z=head_height)]
    parts.append(Sphere(head_radius * 0.5).shift(y=-head_radius * 0.8, z=head_height - 0.05))  # muzzle
    ear_angle = rng.uniform(0.5, 0.9)
    arm_drop, arm_forward = rng.uniform(-0.2, 0.15), rng.uniform(-0.3, 0.0)
    sitting = rng.random() < 0.6
    for side in (-1, 1):
        reach = head_radius * 0.95
        parts.append(
            Sphere(ear).shift(side * reach * math.sin(ear_angle), 0.0, head_height + reach * math.cos(ear_angle))
        )
        shoulder = (side * belly.semi_axes[0] * 0.75, 0.0, belly.semi_axes[2] * 0.45)
        hand = (side * (belly.semi_axes[0] + rng.uniform(0.12, 0.25)), arm_forward, shoulder[2] + arm_drop)
        parts.append(Capsule(shoulder, hand, limb))
        hip = (side * belly.semi_axes[0] * 0.55, 0.0, -belly.semi_axes[2] * 0.7)
        if sitting:
            foot = (side * rng.uniform(0.25, 0.4), -rng.uniform(0.4, 0.55), -belly.semi_axes[2] * 0.95 + limb * 0.5)
        else:
            foot = (side * rng.uniform(0.2, 0.28), -0.05, -belly.semi_axes[2] - rng.uniform(0.15, 0.3))
        parts.append(Capsule(hip, foot, limb * 1.1))
    return stand("plush", SmoothUnion(tuple(parts), rng.uniform(0.05, 0.12)), cut=rng.uniform(0.06, 0.12))


def animal(rng: Rng, thin: bool) -> Shape:
    """Four legs, a trunk, a neck and a head."""
    length, girth = rng.uniform(0.3 if thin else 0.4, 0.5), rng.uniform(0.2, 0.28)
    trunk = Ellipsoid((length + girth * 0.5, girth, girth * rng.uniform(0.9, 1.15)))
    leg = rng.uniform(0.05, 0.09) if thin else rng.uniform(0.18, 0.21)
    drop = rng.uniform(0.35, 0.6) if thin else rng.uniform(0.36, 0.5)
    spread = max(girth * 0.6, leg * 1.25)
    parts: list[Field] = [trunk]
    for x in (-length * 0.8, length * 0.8):
        for side in (-1, 1):
            parts.append(Capsule((x, side * spread, 0.0), (x, side * spread * 1.1, -drop), leg))
    neck_rise, neck_reach = rng.uniform(0.15, 0.45), rng.uniform(0.1, 0.25)
    head_at = (length + neck_reach, 0.0, neck_rise)
    neck = max(leg, rng.uniform(0.1, 0.2))
    parts.append(Capsule((length * 0.8, 0.0, 0.05), head_at, neck))
    head = rng.uniform(0.15, 0.2)
    parts.append(Ellipsoid((head * 1.3, head, head)).shift(*head_at))
    if rng.random() < 0.5:
        tail = leg if not thin else rng.uniform(0.04, 0.07)
        end = (-length - rng.uniform(0.25, 0.4), 0.0, rng.uniform(-0.1, 0.3))
        parts.append(Capsule((-length * 0.8, 0.0, 0.05), end, tail))
    return stand("animal", SmoothUnion(tuple(parts), rng.uniform(0.04, 0.1)), cut=rng.uniform(0.05, 0.1))


def duck(rng: Rng, thin: bool) -> Shape:
    """A bath duck: body, head, beak and tail."""
    body = Ellipsoid((rng.uniform(0.45, 0.55), rng.uniform(0.3, 0.38), rng.uniform(0.26, 0.34)))
    head = rng.uniform(0.2, 0.26)
    head_at = (body.semi_axes[0] * rng.uniform(0.45, 0.65), 0.0, body.semi_axes[2] + head * rng.uniform(0.5, 0.8))
    beak = Ellipsoid((0.12, 0.09, 0.05) if thin else (0.15, 0.15, 0.14))
    beak_at = (head_at[0] + head, 0.0, head_at[2] - 0.04)
    size = 0.06 if thin else 0.15
    tail = Capsule((-body.semi_axes[0] * 0.6, 0, 0.05), (-body.semi_axes[0] * rng.uniform(1.0, 1.2), 0, 0.2), size)
    parts = (body, Sphere(head).shift(*head_at), beak.shift(*beak_at), tail)
    return stand("duck", SmoothUnion(parts, rng.uniform(0.05, 0.14)), cut=rng.uniform(0.1, 0.22))
