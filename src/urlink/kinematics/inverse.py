"""All ways to reach a pose and the closest of them, of published and of calibrated arms, one pose or many.

A published arm is solved in closed form. For a calibrated one each way of the closed form is the beginning of a search.
Where that ends depends on the tilts of the axes only far from singularities. Close to one, within the few mrad that a
calibration tilts the axes, ways appear, disappear and swap places: an arm that is stretched reaches 0.1 mm less far
than published, or joints 4 and 6 cannot be brought in line at all. So where the given joint positions almost do, the
search begins there, and it goes on from several places before a pose counts as out of reach.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .. import rigid
from ..rigid import FLOATS, ROWS, FloatArray, Rigid
from .closed_form import BRANCHES, branches, branches_of_rows
from .geometry import Angles, Geometry
from .refinement import error_at, refine, refine_anywhere, refine_rows

__all__ = ["around", "closest", "closest_rows", "distance", "ways", "ways_of_rows"]

# A way of the closed form further than this from the given joint positions, rad, is not taken for their continuation
# before it is known that they do not almost do: miss the pose by less than the second, m and rad, and lead to one that
# is no further away than the third, rad.
_CONTINUES = 0.1
_ALMOST = 0.02
_ASIDE = 0.5
# Where joint 6 is almost free, by the sine of joint 5, the search also begins at so many positions of it.
_FREE = 0.05
_TURNS = 8


def distance(q: Sequence[float], other: Sequence[float]) -> float:
    """The largest joint movement between two joint positions, rad, each joint going the short way round."""
    return max(abs(math.remainder(a - b, math.tau)) for a, b in zip(q, other, strict=True))


def around(angles: FloatArray) -> FloatArray:
    """The same directions in [-pi, pi]."""
    return angles - math.tau * np.rint(angles / math.tau)


def ways(geometry: Geometry, target: Rigid[float], free_q6: float = 0.0) -> list[Angles[float] | None]:
    """The eight ways in the order of `branches`, rad, not wrapped."""
    if geometry.is_nominal:
        return branches(geometry.lengths, target, free_q6)
    seeds = branches(geometry.lengths, target, free_q6 + geometry.offsets[5], is_loose=True)
    return [None if seed is None else _found(geometry, _less(seed, geometry.offsets), target) for seed in seeds]


def closest(geometry: Geometry, target: Rigid[float], near: Angles[float]) -> Angles[float] | None:
    """The way that is closest to `near`, rad, not wrapped; None if there is none."""
    if geometry.is_nominal:
        return min(
            (way for way in branches(geometry.lengths, target, near[5]) if way is not None),
            key=lambda q: distance(q, near),
            default=None,
        )
    seeds = _seeds(geometry, target, near)
    if seeds and distance(seeds[0], near) < _CONTINUES:
        found = refine(geometry, seeds[0], target)
        if found is not None and distance(found, near) < _CONTINUES:
            return found
    if max(map(abs, error_at(geometry, near, FLOATS, target))) < _ALMOST:
        found = _found(geometry, near, target)
        if found is not None and distance(found, near) < _ASIDE:
            return found
    for turn in range(_TURNS):
        for seed in seeds:
            # Only where joint 6 is free does another position of it lead elsewhere.
            if turn == 0 or abs(math.sin(seed[4])) < _FREE:
                found = _found(geometry, seed, target)
                if found is not None:
                    return found
        seeds = _seeds(geometry, target, near, (turn + 1) * math.tau / _TURNS)
    return None


def _seeds(geometry: Geometry, target: Rigid[float], near: Angles[float], turned: float = 0.0) -> list[Angles[float]]:
    """Where to begin the search for the joint positions of a calibrated arm, the closest first.

    Where joint 6 is free, it is that of `near`, `turned`.
    """
    loose = branches(geometry.lengths, target, near[5] + geometry.offsets[5] + turned, is_loose=True)
    seeds = (_less(way, geometry.offsets) for way in loose if way is not None)
    return sorted(seeds, key=lambda q: distance(q, near))


def _found(geometry: Geometry, seed: Angles[float], target: Rigid[float]) -> Angles[float] | None:
    return refine(geometry, seed, target) or refine_anywhere(geometry, seed, target)


def _less(q: Angles[float], offsets: Angles[float]) -> Angles[float]:
    q1, q2, q3, q4, q5, q6 = (angle - offset for angle, offset in zip(q, offsets, strict=True))
    return q1, q2, q3, q4, q5, q6


def closest_rows(geometry: Geometry, targets: Rigid[FloatArray], nears: FloatArray) -> FloatArray:
    """`closest` of n transforms and (n, 6) joint positions: (n, 6) rad, NaN where there is none."""
    found, singular = branches_of_rows(geometry.lengths, targets)
    found -= np.array(geometry.offsets)[:, np.newaxis]
    moves = np.abs(around(found - nears.T)).max(axis=1)
    moves[np.isnan(moves)] = np.inf
    chosen = moves.argmin(axis=0)
    q = np.take_along_axis(found, chosen[np.newaxis, np.newaxis], axis=0)[0]
    again = singular
    if not geometry.is_nominal:
        q = refine_rows(geometry, q, targets)
        again = singular | np.isnan(q[0])
        far = np.flatnonzero(~again & (moves.min(axis=0) > _CONTINUES))
        if len(far):
            q1, q2, q3, q4, q5, q6 = nears[far].T
            missed = error_at(geometry, (q1, q2, q3, q4, q5, q6), ROWS, rigid.take(targets, far))
            again[far] = np.max(np.abs(missed), axis=0) < _ALMOST
    rows: FloatArray = q.T
    for i in np.flatnonzero(again).tolist():
        q1, q2, q3, q4, q5, q6 = nears[i].tolist()
        one = closest(geometry, rigid.row(targets, i), (q1, q2, q3, q4, q5, q6))
        rows[i] = np.nan if one is None else one
    return rows


def ways_of_rows(geometry: Geometry, targets: Rigid[FloatArray]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """`ways` of n transforms.

    Returns:
        (n, 8, 6) rad, in (-pi, pi], NaN out of reach; and (n,) whether the wrist is close to its singularity.
    """
    found, singular = branches_of_rows(geometry.lengths, targets)
    again = singular
    if not geometry.is_nominal:
        found -= np.array(geometry.offsets)[:, np.newaxis]
        number = found.shape[2]
        seeds = found.transpose(1, 0, 2).reshape(6, -1)
        refined = refine_rows(geometry, seeds, rigid.take(targets, np.tile(np.arange(number), BRANCHES)))
        found = refined.reshape(6, BRANCHES, number).transpose(1, 0, 2)
        again = singular | np.isnan(found[:, 0]).any(axis=0)
    rows = np.ascontiguousarray(found.transpose(2, 0, 1))
    for i in np.flatnonzero(again).tolist():
        each = ways(geometry, rigid.row(targets, i))
        rows[i] = [[math.nan] * 6 if way is None else way for way in each]
    rows -= math.tau * np.ceil(rows / math.tau - 0.5)  # in (-pi, pi]
    return rows, again
