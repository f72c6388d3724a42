# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Forward dynamics on the emulated machine: accelerations, steps, utilisation and status.

The same program that kernels compile runs here in lock-step on n processors. Fewer processors take
several steps for an instruction on more lanes than they are; one runs the program of one
processor. With `digits` the program runs on mpmath numbers and gives the reference for errors.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.dynamics.methods import FORWARD, SERIAL, record_forward_dynamics
from pfd_core.dynamics.refinement import CORRECTION
from pfd_core.forking import no_fork
from pfd_core.machine.emulator import run
from pfd_core.machine.iteration import TOLERANCES
from pfd_core.machine.program import Program, Steps
from pfd_core.model.effects import INPUT
from pfd_core.model.plant import Plant, check_instant, resolve
from pfd_core.model.robot import Robot, check_robot
from pfd_core.model.scene import Scene, given_scene, scene_inputs
from pfd_core.model.values import DTYPES, Array, choice, common_shape, integer, quote, real_array
from pfd_core.paper import networks
from pfd_core.paper.array import SECTION, STREAMS, solve_cycles, solve_steps, stream_steps
from pfd_core.paper.composite import record_residual
from pfd_core.paper.editions import AS_PRINTED

# mpmath computes with more digits, but for hours.
MOST_DIGITS = 10_000
# An answer whose error is estimated as more than so many roundings, times the condition of H, is
# not right. Those that have converged keep far below, those of n iterations are spread over all
# orders up to 1e14 (docs/report/counts.md, 372 chains).
ROUNDINGS = 250.0
# So many units of rounding for each joint of what is added up are no number, but noise.
NOISE = 8.0


@dataclass(frozen=True, eq=False)
class Run:
    """
    Result of an emulated run.

    Attributes
    ----------
    qdd : numpy.ndarray
        Accelerations, (..., n) [rad/s^2 or m/s^2]; mpmath numbers with `digits`.
    steps : Steps
        Lock-step counts of the program as written, on the processors that ran it.
    steps_by_section : dict
        The same for each part of the program that takes any.
    utilisation : float
        Share of the processors' arithmetic steps that did useful work, 0 to 1; cells of the
        triangular array count as processors.
    error : float
        Estimate of the relative error of qdd, of a batch the largest: `max|H^-1 r|` over the
        largest of `|qdd|` and `|H^-1 tau|`, where r is the torque that qdd misses. Infinite where
        r is not finite.
    allowed : float
        Largest error of a right answer: 250 units of rounding (of float64 also with `digits`)
        times the condition of H, scaled to ones on its diagonal, and the rounding of torques of
        gravity that cancel; at most 0.005. Of a batch the smallest.
    status : str
        'ok' of any method: `error` is at most `allowed`. Else 'not_positive_definite' if H is
        singular, also if only up to rounding, or a pivot was not above zero; 'not_finite';
        'not_converged' of an iterative method, also if it ran into its limit; 'inaccurate' of a
        direct one; 'wrong' of the printed edition. Of a batch, each answer must be right.
    iterations, cycles : int or None
        Iterations of an iterative method (of a batch, the most), cycles of the array; None for
        the others.
    program : Program
        The program that was run; `print(run.program)` shows it.

    """

    qdd: NDArray[Any]
    steps: Steps
    steps_by_section: dict[str, Steps]
    utilisation: float
    error: float
    allowed: float
    status: str
    iterations: int | None
    cycles: int | None
    program: Program = field(repr=False)

    # mpmath rounds a pickled number to the precision that is set where it is unpickled.
    def __getstate__(self) -> dict[str, Any]:
        if self.qdd.dtype != object:
            return self.__dict__
        return self.__dict__ | {'qdd': np.frompyfunc(lambda x: x._mpf_, 1, 1)(self.qdd)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        if self.qdd.dtype == object:
            with no_fork:
                import mpmath

            self.__dict__['qdd'] = np.frompyfunc(mpmath.make_mpf, 1, 1)(self.qdd)


def emulate(
    robot: Robot,
    q: ArrayLike,
    qd: ArrayLike,
    tau: ArrayLike,
    *,
    method: str = 'pcrbm',
    scene: Scene | None = None,
    wrench: ArrayLike | None = None,
    brakes: ArrayLike | None = None,
    processors: int | None = None,
    network: str = 'crossbar',
    dtype: str = 'float64',
    digits: int | None = None,
    edition: str = 'corrected',
) -> Run:
    """
    Run forward dynamics on the emulated SIMD computer.

    Parameters
    ----------
    robot, q, qd, tau, scene, wrench, brakes
        As for forward_dynamics.
    method : str
        A name in METHODS or EMULATED_METHODS; 'pcrbm_1987' and 'pcgm_1987' are the paper's
        procedures step by step. The paper's counts are without the section 'joint rotation' of
        `steps_by_section`: it takes R_i as given.
    processors : int, optional
        From 1 to n; default n, or 1 for a serial method. Between 1 and n the program of n
        processors is run, and an instruction on k lanes counts ceil(k / processors) steps. On one
        processor the steps are the operations of the serial program of the method.
    network : str
        Network of the n processors: 'crossbar', 'pm2i', 'cube', 'mesh', 'ring', 'shuffle' or
        'bus' (pfd_core.paper.networks). Routes are executed and counted hop by hop.
    dtype : {'float64', 'float32'}
        Numbers of the machine. An iterative method stops at the rounding of this format.
    digits : int, optional
        Compute with mpmath numbers of this many decimal digits instead. All of them are right
        for 'pcrbm' and its forms, and 'divide_and_conquer', which take the rotations of the robot
        as they are. They are float64 and orthogonal up to rounding; the serial methods,
        'articulated_body_doubling' and 'constraint_forces' use that R' R is 1 or take angles of
        it, and differ in the 16th digit, which is right for the status and which `error` shows.
    edition : {'corrected', 'printed'}
        'printed' runs a procedure of the paper with its misprints (pfd_core.paper.editions).

    Raises
    ------
    ValueError
        If an argument has the wrong shape or type, is unknown, is out of bounds, or is not finite.
    """
    check_robot(robot)
    choice('method', method, FORWARD)
    choice('dtype', dtype, DTYPES)
    choice('network', network, networks.NETWORKS)
    printed = choice('edition', edition, ('corrected', 'printed')) == 'printed'
    if printed and method not in AS_PRINTED:
        raise ValueError(
            f"edition 'printed' needs one of the methods {tuple(AS_PRINTED)}, got {method!r}"
        )
    if digits is not None:
        # In mpmath numbers, of any digits, the residual falls as far as in double precision.
        digits, dtype = integer('digits', digits, 1, MOST_DIGITS), 'float64'
    if processors is not None:
        processors = integer('processors', processors, 1, robot.n)
    if method in SERIAL and processors not in (None, 1):
        raise ValueError(
            f'processors must be 1 for the serial method {method!r}, got {processors}'
        )
    scene = given_scene(scene, wrench)
    if scene.payload == INPUT:
        raise ValueError(f'emulate takes a scene with a Payload or None, got payload={INPUT!r}')
    plant = resolve(robot, scene)
    if robot.followers:
        name = quote(robot.followers[0].name)
        raise ValueError(f'emulate takes no joint that follows another, such as {name}')
    schedule = 'sequential' if processors == 1 else 'parallel'
    if printed:
        check_instant(plant)
        program = FORWARD[method](plant, schedule, misprints=AS_PRINTED[method])
    else:
        program = record_forward_dynamics(plant, method, schedule, TOLERANCES[dtype])
    given: dict[str, ArrayLike] = {'q': q, 'qd': qd, 'tau': tau}
    given |= scene_inputs(scene, robot.n, 'float64', wrench, brakes)
    if wrench is not None:
        given['wrench'] = wrench  # with digits, a fraction stays exact
    check = record_residual(plant)
    sizes = {name: size for name, size in check.inputs.items() if name != 'qdd'}
    inputs = _checked(sizes | program.inputs, given, dtype, digits)
    # On a crossbar each lane reads its source in one hop.
    carrier = None if network == 'crossbar' else networks.carrier(network)
    result = run(program, inputs, dtype, digits, route=carrier)
    # Outside the counted program, and with no fewer digits than float64.
    found = run(check, inputs | {'qdd': result['qdd']}, 'float64', digits)
    most = _at_most(plant, np.asarray(inputs['q'], np.float64))
    error, allowed, singular = _error(
        result['qdd'], found, inputs.get('free'), dtype, most, bool(digits)
    )
    iterations = None
    if 'iterations' in result:
        iterations = int(np.max(np.asarray(result['iterations'], dtype=np.float64), initial=0))
    p = processors or program.lanes
    sections = networks.by_section(program, network, p, iterations or 0)
    if method == 'pcrbm_array':
        # The cells work side by side: there the cycles count, not the operations of all cells,
        # and routes bring H to the rows of the array, not to one lane.
        sections |= {SECTION: solve_steps(robot.n), STREAMS: stream_steps(robot.n, p, network)}
    steps = sum(sections.values(), Steps())
    work = arithmetic(program.count(1, iterations=iterations or 0))
    units = processors_of(method, robot.n, p)
    return Run(
        qdd=result['qdd'],
        steps=steps,
        steps_by_section={name: own for name, own in sections.items() if own != Steps()},
        utilisation=work / (arithmetic(steps) * units) if arithmetic(steps) else 0.0,
        error=float(np.max(error, initial=0.0)),
        allowed=float(np.min(allowed, initial=CORRECTION)),
        status=_status(result, printed, bool(np.any(singular)), bool(np.all(error <= allowed))),
        iterations=iterations,
        cycles=solve_cycles(robot.n) if method == 'pcrbm_array' else None,
        program=program,
    )


def processors_of(method: str, n: int, processors: int) -> int:
    """Return the processors of a method's machine: `processors`, and the cells of the array."""
    return processors + (n * (n + 1) // 2 if method == 'pcrbm_array' else 0)


def arithmetic(steps: Steps) -> int:
    """Return the steps of arithmetic, each counted as one: routes are not among them."""
    return int(sum(asdict(steps).values())) - steps.routes


def _checked(
    sizes: dict[str, int], given: dict[str, ArrayLike], dtype: str, digits: int | None
) -> dict[str, Any]:
    """Return the inputs as arrays of one batch shape; ValueError for a wrong one."""
    arrays = {}
    for name, size in sizes.items():
        array = real_array(name, given[name], 'float64', (..., size))
        real_array(name, array, dtype)  # raises for a number that does not fit
        arrays[name] = np.asarray(given[name], dtype=object) if digits else array
    shape = common_shape(arrays)
    return {
        name: np.broadcast_to(array, (*shape, array.shape[-1])) for name, array in arrays.items()
    }


@np.errstate(all='ignore')
def _at_most(plant: Plant, q: Array) -> tuple[Array, Array]:
    """
    Return the largest inertia and gravity torque of the links beyond each joint, (..., n).

        S_i = sum of trace J_j + m_j r_ij^2,   G_i = |g| sum of m_j r_ij,   j >= i
        r_ij = |p*_i| + .. + |p*_(j-1)| + distance of joint j and the centre of link j

    r_ij and J_j of a sliding joint are 1 and 0; S has the rotors. H and the bias are rounded to
    some units of these, however small they are themselves.
    """
    robot, turns = plant.robot, plant.robot.turning
    slides = np.where(turns, 0.0, abs(q))
    steps = np.linalg.norm(robot.translations, axis=-1) + slides
    arms = robot.translations + np.einsum('ijk,ik->ij', robot.rotations, robot.centers)
    starts = np.cumsum(steps, -1) - steps
    ends = starts + np.linalg.norm(arms, axis=-1) + slides
    reach = np.where(turns[:, None], ends[..., None, :] - starts[..., None], 1.0)
    own = np.where(turns[:, None], np.trace(robot.inertias, axis1=1, axis2=2), 0.0)
    S = np.triu(own + robot.masses * reach**2).sum(-1)
    S = S if plant.inertia is None else S + plant.inertia
    return S, np.linalg.norm(plant.gravity) * np.triu(robot.masses * reach).sum(-1)


def _error(
    qdd: NDArray[Any],
    found: dict[str, Any],
    free: NDArray[Any] | None,
    dtype: str,
    most: tuple[Array, Array],
    exact: bool,
) -> tuple[Array, Array, Array]:
    """
    Return the error of accelerations, the largest of a right answer, and whether H is singular.

        error = max|H^-1 r| / scale,  scale = max(|qdd|, |H^-1 tau|)           as in Run
        allowed = u (ROUNDINGS cond(H) + NOISE n max(|H^-1| G) / scale);  at most CORRECTION
        singular   S^-1/2 H S^-1/2 has an eigenvalue of at most NOISE n units of float64

    with H scaled to ones on its diagonal for its condition, and S and G of _at_most. A pivot that
    is nothing but rounding is 1 on a diagonal of ones, but stays small beside S; if H is `exact`
    there is none. The error is infinite where r is not finite or the diagonal of H not above zero.
    """
    H, r, tau, qdd, S, G = (
        np.asarray(x, np.float64)
        for x in (found['H'], found['residual'], found['motors'], qdd, *most)
    )
    n = H.shape[-1]
    one = np.eye(n)
    if free is not None:
        moves = np.asarray(free, np.float64) > 0
        H = np.where(moves[..., None] & moves[..., None, :], H, one)
        r, tau, S, G = (np.where(moves, x, y) for x, y in ((r, 0), (tau, 0), (S, 1), (G, 0)))
    diagonal = np.diagonal(H, axis1=-2, axis2=-1)
    finite = np.isfinite(H).all((-1, -2))
    sound = np.logical_and(finite, (diagonal > 0).all(-1))[..., None]
    H, diagonal = np.where(sound[..., None], H, one), np.where(sound, diagonal, 1.0)
    values, vectors = np.linalg.eigh(_scaled(H, diagonal))
    least = np.linalg.eigvalsh(_scaled(H, np.maximum(S, diagonal)))[..., 0]
    double, unit = np.finfo(np.float64).eps / 2, np.finfo(dtype).eps / 2
    lost = (least <= NOISE * n * double) & (not exact)
    singular = finite & (~sound[..., 0] | lost)
    with np.errstate(all='ignore'):
        inverse = (vectors / values[..., None, :]) @ np.swapaxes(vectors, -1, -2)
        inverse = _scaled(inverse, diagonal)

        def most_of(matrix: Array, torques: Array) -> Any:
            return abs((matrix @ torques[..., None])[..., 0]).max(-1)

        missing = most_of(inverse, r)
        scale = np.maximum(abs(qdd).max(-1), most_of(inverse, tau))
        error = np.where(missing == 0, 0.0, np.where(sound[..., 0], missing / scale, np.inf))
        condition = abs(values).max(-1) / abs(values).min(-1)
        allowed = unit * (ROUNDINGS * condition + NOISE * n * most_of(abs(inverse), G) / scale)
    error = np.where(np.isnan(error), np.inf, error)
    return error, np.fmin(allowed, CORRECTION), singular


def _scaled(H: Array, diagonal: Array) -> Array:
    scale = np.sqrt(diagonal)
    return H / scale[..., None] / scale[..., None, :]


def _status(result: dict[str, Any], printed: bool, singular: bool, right: bool) -> str:
    def positive(name: str) -> bool:
        """Return whether a result is above zero, as far as the program has it."""
        return name not in result or bool((np.asarray(result[name], np.float64) > 0).all())

    if printed:
        return 'ok' if right else 'wrong'
    if singular or not positive('pivots'):
        return 'not_positive_definite'
    if not np.isfinite(np.asarray(result['qdd'], np.float64)).all():
        return 'not_finite'
    if right and positive('converged'):
        return 'ok'
    return 'not_converged' if 'iterations' in result else 'inaccurate'
