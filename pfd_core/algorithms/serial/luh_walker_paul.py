# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Joint torques by the Newton-Euler recursion of Luh, Walker and Paul, on one processor.

With R_i' (.) taking a vector to the axes of link i, and z = (0, 0, 1) in the axes of link i-1

    w_i  = R_i' (w_(i-1) [+ z qd_i])                                   base to tip
    wd_i = R_i' (wd_(i-1) [+ z qdd_i + w_(i-1) x z qd_i])              [rotational]
    a_i  = R_i' (a_(i-1) {+ z qdd_i + 2 w_(i-1) x z qd_i}) + wd x p + w x (w x p)
    F_i  = m (a + wd x s + w x (w x s)),  N_i = J wd + w x (J w)       {translational}
    f_i  = R_(i+1) f_(i+1) + F_i                                       tip to base
    n_i  = R_(i+1) n_(i+1) + N_i + s x F_i + p x f_i
    tau_i = z . R_i n_i  (rotational),  z . R_i f_i  (translational)

Luh, Walker and Paul 1980; Walker and Orin 1982 run it n + 1 times. The base is accelerated
by minus gravity; the wrench on the last link is -f_(n+1), -n_(n+1).

Serial cost, rotational joints, n > 1, multiplications and additions:
bias (velocities and gravity) 117 n - 95 and 89 n - 78; H u (accelerations alone) 68 n - 56 and
53 n - 45. Lee and Chang 1987 have no counts of these parts.

Everything is in the axes of its link; one register holds one number.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pfd_core.algorithms.chain.link_axes import Link, plus, tilted, turned, untilted, unturned
from pfd_core.machine.recorder import LaneArray, Lanes
from pfd_core.machine.vectors import array, cross


def newton_euler(
    links: Sequence[Link],
    qd: Sequence[Lanes] | None,
    qdd: Sequence[Lanes | None],
    gravity: LaneArray | None = None,
    wrench: tuple[LaneArray, LaneArray] | None = None,
) -> list[Lanes | None]:
    """
    Return the torques of rigid links at the given velocities and accelerations.

    Parameters
    ----------
    links : sequence of Link
        The chain, or the part of it that moves.
    qd : sequence of Lanes or None
        Joint velocities [rad/s or m/s]; None for rest.
    qdd : sequence of Lanes or None
        Joint accelerations [rad/s^2 or m/s^2]; None for a known zero.
    gravity, wrench
        As in Chain.

    Returns
    -------
    list of Lanes or None
        Torques of the joints of these links [N m or N]; None for a known zero.

    """
    w = wd = None
    a: Any = gravity
    forces = []
    for i, link in enumerate(links):
        w, wd, a = _motion(link, (w, wd, a), None if qd is None else qd[i], qdd[i])
        forces.append(_force(link, w, wd, a))
    return _torques(links, forces, wrench)


def _motion(
    link: Link, before: tuple[Any, Any, Any], qd: Lanes | None, qdd: Lanes | None
) -> tuple[Any, Any, Any]:
    """Return the link's angular velocity and acceleration and its frame's acceleration."""
    w, wd, a = before
    c = coriolis(w, qd)
    if link.slides:
        twice = None if c is None else c + c
        w, wd = outward(link, w, None), outward(link, wd, None)
        a = outward(link, plus_in_plane(a, twice), qdd)
    else:
        wd = outward(link, plus_in_plane(wd, c), qdd)
        w = outward(link, w, qd)
        a = outward(link, a, None)
    if link.p is not None:
        a = plus(a, _cross(wd, link.p), centripetal(w, link.p))
    return w, wd, a


def coriolis(w: Any, qd: Lanes | None) -> Any:
    """Return x and y of w x z qd, (2,), whose third component is zero; None if w or qd is."""
    return None if w is None or qd is None else array([w[1] * qd, -(w[0] * qd)])


def plus_in_plane(v: Any, xy: Any) -> Any:
    """Return v plus a vector without z component."""
    if xy is None:
        return v
    if v is None:
        return array([*xy, xy[0].recorder.constant(0.0)])
    return array([v[0] + xy[0], v[1] + xy[1], v[2]])


def outward(link: Link, v: Any, along_z: Lanes | None) -> Any:
    """Return v + z along_z from the axes of link i-1 to the axes of link i."""
    if along_z is None:
        return untilted(link, unturned(link, v))
    if v is None:  # a vector along z does not change when it is turned about z
        zero = along_z.recorder.constant(0.0)
        if link.tilt is None:
            return array([zero, zero, along_z])
        return array([zero, link.tilt[1] * along_z, link.tilt[0] * along_z])
    return untilted(link, unturned(link, array([v[0], v[1], v[2] + along_z])))


def centripetal(w: Any, p: LaneArray) -> Any:
    """Return w x (w x p); None if w is."""
    return None if w is None else cross(w, cross(w, p))


def _cross(a: Any, b: Any) -> Any:
    return None if a is None or b is None else cross(a, b)


def _force(link: Link, w: Any, wd: Any, a: Any) -> tuple[Any, Any]:
    """Return the force on the centre of mass and the moment about it for a link's motion."""
    r = plus(a, _cross(wd, link.s), centripetal(w, link.s))
    N = plus(
        None if wd is None else link.J @ wd,
        None if w is None else cross(w, link.J @ w),
    )
    return None if r is None else link.m * r, N


def _torques(
    links: Sequence[Link],
    forces: Sequence[tuple[Any, Any]],
    wrench: tuple[LaneArray, LaneArray] | None,
) -> list[Lanes | None]:
    """Return the joint torques of forces F on the centres of mass and moments N."""
    f, n = (None, None) if wrench is None else (-wrench[0], -wrench[1])
    tau: list[Lanes | None] = []
    for i in range(len(links) - 1, -1, -1):
        link, (F, N) = links[i], forces[i]
        f = plus(f, F)
        n = plus(n, N, _cross(link.s, F), _cross(link.p, f))
        if i == 0:
            tau.append(along_axis(link, f if link.slides else n))
        else:
            f, n = tilted(link, f), tilted(link, n)
            felt = f if link.slides else n
            tau.append(None if felt is None else felt[2])
            f, n = turned(link, f), turned(link, n)
    return tau[::-1]


def along_axis(link: Link, v: Any) -> Lanes | None:
    """Return the component of a vector in the link's axes along the axis of its joint."""
    if v is None or link.tilt is None:
        return None if v is None else v[2]
    c, s = link.tilt
    result: Lanes = s * v[1] + c * v[2]
    return result
