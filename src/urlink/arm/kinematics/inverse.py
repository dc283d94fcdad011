"""Inverse kinematics of published and calibrated arms: all branches or the closest one, for one pose or many.

A published arm is solved in closed form. For a calibrated arm, each branch of the closed form is the seed of a search.
A calibration tilts the axes by a few mrad. If an arm is within a few mrad of a singularity, branches appear, disappear
or swap. For example, a stretched arm reaches 0.1 mm further or less far than the published arm, or the axes of joints 4
and 6 cannot become parallel at all. Therefore the search begins at the given joint positions if they almost reach the
pose. Many seeds are tried before a pose counts as out of reach.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .. import rigid
from ..rigid import FLOATS, ROWS, Rigid
from ..vectors import FloatArray
from .closed_form import BRANCHES, SINGULAR, SLACK, solve, solve_rows
from .geometry import Angles, Geometry, angles
from .refinement import error_at, refine, refine_anywhere, refine_rows

# `near` is a seed if it misses the pose by less than `_ALMOST`, in m and rad. A solution that is further away from
# `near` than `_CONTINUES`, in rad, does not count as a continuation of the motion.
_ALMOST = 0.05
_CONTINUES = 0.3
# Settings of the last attempt, `_search`. This function tries `_TURNS` values of joint 6. A seed may use the tried
# value if the orientation error is then below `_SLACK`, in rad. `_SLACK` approximately equals the tilt of the axes. A
# seed is skipped if it is within `_TRIED`, in rad, of an earlier seed.
_SLACK = 0.03
_TURNS = 16
_TRIED = 1e-3


_remainder, _TURN = math.remainder, math.tau


def distance(q: Sequence[float], other: Sequence[float]) -> float:
    """Return the largest joint motion between two joint positions, in rad, modulo whole turns."""
    a1, a2, a3, a4, a5, a6 = q
    b1, b2, b3, b4, b5, b6 = other
    # Six calls take less than half the time of a loop, and this function runs eight times for each pose.
    return max(
        abs(_remainder(a1 - b1, _TURN)),
        abs(_remainder(a2 - b2, _TURN)),
        abs(_remainder(a3 - b3, _TURN)),
        abs(_remainder(a4 - b4, _TURN)),
        abs(_remainder(a5 - b5, _TURN)),
        abs(_remainder(a6 - b6, _TURN)),
    )


def around(angles: FloatArray) -> FloatArray:
    """Return the same angles in [-pi, pi]."""
    return angles - math.tau * np.rint(angles / math.tau)


def branches(geometry: Geometry, target: Rigid[float], free_q6: float = 0.0) -> list[Angles[float] | None]:
    """Return the eight branches in the order of `Arm.branches`, in rad, not wrapped."""
    if geometry.is_nominal:
        return solve(geometry.lengths, target, free_q6)
    seeds = solve(geometry.lengths, target, free_q6 + geometry.offsets[5], slack=_SLACK, is_loose=True)
    return [None if seed is None else _found(geometry, _less(seed, geometry.offsets), target) for seed in seeds]


def closest(geometry: Geometry, target: Rigid[float], near: Angles[float]) -> Angles[float] | None:
    """Return the branch that is closest to `near`, in rad, not wrapped; None if the pose is out of reach."""
    if geometry.is_nominal:
        solutions = [q for q in solve(geometry.lengths, target, near[5]) if q is not None]
        return min(solutions, key=lambda q: distance(q, near), default=None)
    found = refine(geometry, near, target, _ALMOST)
    if found is None and max(map(abs, error_at(geometry, near, FLOATS, target))) < _ALMOST:
        found = refine_anywhere(geometry, near, target)
    if found is not None and distance(found, near) < _CONTINUES:
        return found
    seed = min(_seeds(geometry, target, near[5]), key=lambda q: distance(q, near), default=None)
    found = None if seed is None else refine(geometry, seed, target)
    return found if found is not None else _search(geometry, target, near)


def _search(geometry: Geometry, target: Rigid[float], near: Angles[float]) -> Angles[float] | None:
    """Try many seeds for a pose in a singularity or at the edge of the reach, and return the first solution found."""
    tried: list[Angles[float]] = []
    for turn in range(_TURNS):
        seeds = _seeds(geometry, target, near[5] + turn * math.tau / _TURNS, _SLACK)
        for seed in sorted(seeds, key=lambda q: distance(q, near)):
            if all(distance(seed, other) > _TRIED for other in tried):
                tried.append(seed)
                found = _found(geometry, seed, target)
                if found is not None:
                    return found
    return None


def _seeds(geometry: Geometry, target: Rigid[float], free_q6: float, slack: float = SLACK) -> list[Angles[float]]:
    """Return the seeds of the search for the joint positions of a calibrated arm."""
    loose = solve(geometry.lengths, target, free_q6 + geometry.offsets[5], slack=slack, is_loose=True)
    return [_less(q, geometry.offsets) for q in loose if q is not None]


def _found(geometry: Geometry, seed: Angles[float], target: Rigid[float]) -> Angles[float] | None:
    return refine(geometry, seed, target) or refine_anywhere(geometry, seed, target)


def _less(q: Angles[float], offsets: Angles[float]) -> Angles[float]:
    q1, q2, q3, q4, q5, q6 = q
    o1, o2, o3, o4, o5, o6 = offsets
    return q1 - o1, q2 - o2, q3 - o3, q4 - o4, q5 - o5, q6 - o6


def closest_of_rows(geometry: Geometry, targets: Rigid[FloatArray], nears: FloatArray) -> FloatArray:
    """Apply `closest` to n transforms and joint positions, shape (n, 6), in rad; NaN if there is no solution.

    Rows that the array formulas cannot solve are passed to `closest`, one by one.
    """
    rows = np.full_like(nears, np.nan)
    again = np.zeros(len(nears), dtype=bool)
    rest = np.arange(len(nears))
    if not geometry.is_nominal:
        rows = refine_rows(geometry, np.ascontiguousarray(nears.T), targets, _ALMOST).T
        again = np.abs(rows - nears).max(axis=1) >= _CONTINUES
        rest = np.flatnonzero(np.isnan(rows[:, 0]))
    if len(rest) and not geometry.is_nominal:
        missed = error_at(geometry, angles(nears[rest].T), ROWS, rigid.take(targets, rest))
        almost = np.max(np.abs(missed), axis=0) < _ALMOST
        again[rest[almost]] = True
        rest = rest[~almost]
    if len(rest):
        chosen, unsure = _closest_branches(geometry, rigid.take(targets, rest), nears[rest])
        if not geometry.is_nominal:
            refined = refine_rows(geometry, chosen, rigid.take(targets, rest))
            unsure |= np.isnan(refined[0]) & ~np.isnan(chosen[0])
            chosen = refined
        rows[rest], again[rest] = chosen.T, unsure
    for i in np.flatnonzero(again).tolist():
        one = closest(geometry, rigid.row(targets, i), angles(nears[i].tolist()))
        rows[i] = np.nan if one is None else one
    return rows


def _closest_branches(
    geometry: Geometry, targets: Rigid[FloatArray], nears: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the closest branch of the closed form, (6, n) in rad, and whether another one might be closer, (n,)."""
    found, sines = solve_rows(geometry.lengths, targets, is_loose=not geometry.is_nominal)
    found -= np.array(geometry.offsets)[:, np.newaxis]
    turns = np.abs(around(found - nears.T))
    moves = turns.max(axis=1)
    moves[np.isnan(moves)] = np.inf
    chosen, least = moves.argmin(axis=0), moves.min(axis=0)
    # If joint 6 can have any value, joints 2 to 6 depend on this value, so only joint 1 gives a lower bound of the
    # distance. Such a branch might reach the pose with one value of joint 6, although it does not reach the pose with
    # another.
    unsure = np.asarray(((sines < SINGULAR) & ~(turns[:, 0] > least)).any(axis=0))
    if not geometry.is_nominal:
        unsure |= np.isinf(least) & (sines < _SLACK).any(axis=0)
    return np.take_along_axis(found, chosen[np.newaxis, np.newaxis], axis=0)[0], unsure


def branches_of_rows(geometry: Geometry, targets: Rigid[FloatArray]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Apply `branches` to n transforms.

    Returns:
        Joint positions, shape (n, 8, 6), in rad, in (-pi, pi]; NaN if a branch does not reach the pose. Also whether
        each pose is close to a singularity, shape (n,).
    """
    found, sines = solve_rows(geometry.lengths, targets, is_loose=not geometry.is_nominal)
    again = np.asarray((sines < (SINGULAR if geometry.is_nominal else _SLACK)).any(axis=0))
    if not geometry.is_nominal:
        found -= np.array(geometry.offsets)[:, np.newaxis]
        number = found.shape[2]
        seeds = found.transpose(1, 0, 2).reshape(6, -1)
        at = np.flatnonzero(~np.isnan(seeds[0]))
        refined = np.full_like(seeds, np.nan)
        refined[:, at] = refine_rows(geometry, seeds[:, at], rigid.take(targets, at % number))
        again |= (np.isnan(refined[0]) & ~np.isnan(seeds[0])).reshape(BRANCHES, number).any(axis=0)
        found = refined.reshape(6, BRANCHES, number).transpose(1, 0, 2)
    rows = np.ascontiguousarray(found.transpose(2, 0, 1))
    for i in np.flatnonzero(again).tolist():
        each = branches(geometry, rigid.row(targets, i))
        rows[i] = [[math.nan] * 6 if q is None else q for q in each]
    rows -= math.tau * np.ceil(rows / math.tau - 0.5)  # in (-pi, pi]
    return rows, again
