# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Forward dynamics on the emulated machine: accelerations, steps, utilisation and status.

The same program that kernels compile runs here in lock-step on n processors. Fewer processors take
several steps for an instruction on more lanes than they are; one runs the program of one
processor. With `digits` the program runs on mpmath numbers and gives the reference for errors.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfd_core.dynamics.convergence import CORRECTION
from pfd_core.dynamics.methods import FORWARD, SERIAL, record_forward_dynamics
from pfd_core.forking import no_fork
from pfd_core.machine.emulator import run
from pfd_core.machine.iteration import TOLERANCES
from pfd_core.machine.program import Program, Steps
from pfd_core.model import Robot, Scene, check_instant, given_scene, resolve, scene_inputs
from pfd_core.model.effects import INPUT
from pfd_core.model.values import DTYPES, choice, common_shape, integer, real_array
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


@dataclass(frozen=True)
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
    status : str
        'ok'; 'not_positive_definite' if a pivot of H was not above zero; 'not_converged' if an
        iterative method ran into its limit, or `error` is above ROUNDINGS units of rounding times
        the condition of H, scaled to ones on its diagonal; 'wrong' if the error of an answer of
        the printed edition is; 'not_finite'.
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
    status: str
    iterations: int | None
    cycles: int | None
    program: Program

    # mpmath rounds a pickled number to the precision that is set where it is unpickled.
    def __getstate__(self) -> dict[str, Any]:
        if self.qdd.dtype != object:
            return self.__dict__
        return self.__dict__ | {'qdd': (self.qdd.shape, [x._mpf_ for x in self.qdd.flat])}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        if isinstance(self.qdd, tuple):
            with no_fork:
                import mpmath

            shape, parts = self.qdd
            qdd = np.empty(len(parts), dtype=object)
            qdd[:] = [mpmath.make_mpf(part) for part in parts]
            self.__dict__['qdd'] = qdd.reshape(shape)


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
        Network that joins the n processors: 'crossbar', 'pm2i', 'cube', 'mesh', 'ring', 'shuffle'
        or 'bus' (pfd_core.paper.networks). Routes are executed hop by hop, and counted in steps
        of that network.
    dtype : {'float64', 'float32'}
        Numbers of the machine. An iterative method stops at the rounding of this format.
    digits : int, optional
        Compute with mpmath numbers of this many decimal digits instead.
    edition : {'corrected', 'printed'}
        'printed' runs one of the paper's procedures with its misprints
        (pfd_core.paper.editions).

    Raises
    ------
    ValueError
        If an argument has the wrong shape or type, is unknown, is out of bounds, or is not finite.

    """
    choice('method', method, FORWARD)
    choice('dtype', dtype, DTYPES)
    choice('network', network, networks.NETWORKS)
    printed = choice('edition', edition, ('corrected', 'printed')) == 'printed'
    if printed and method not in AS_PRINTED:
        raise ValueError(
            f"edition 'printed' needs one of the methods {tuple(AS_PRINTED)}, got {method!r}"
        )
    if digits is not None:
        digits = integer('digits', digits, 1, MOST_DIGITS)
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
    schedule = 'sequential' if processors == 1 else 'parallel'
    if printed:
        check_instant(plant)
        program = FORWARD[method](plant, schedule, misprints=AS_PRINTED[method])
    else:
        # In mpmath numbers, of any digits, the residual falls as far as in double precision.
        tolerance = TOLERANCES.get('float64' if digits else dtype)
        program = record_forward_dynamics(plant, method, schedule, tolerance)
    given: dict[str, ArrayLike] = {'q': q, 'qd': qd, 'tau': tau}
    given |= scene_inputs(scene, robot.n, 'float64', wrench, brakes)
    if wrench is not None:
        given['wrench'] = wrench  # with digits, a fraction stays exact
    check = record_residual(plant)
    sizes = {name: size for name, size in check.inputs.items() if name != 'qdd'}
    inputs = _checked(sizes | program.inputs, given, digits)
    # On a crossbar each lane reads its source in one hop.
    carrier = None if network == 'crossbar' else networks.carrier(network)
    result = run(program, inputs, dtype, digits, route=carrier)
    # Outside the counted program.
    found = run(check, inputs | {'qdd': result['qdd']}, dtype, digits)
    error, bound = _error(result['qdd'], found, inputs.get('free'), dtype)
    iterations = None
    if 'iterations' in result:
        iterations = int(np.max(np.asarray(result['iterations'], dtype=np.float64), initial=0))
    p = processors or program.lanes
    sections = networks.by_section(program, network, p, iterations or 1)
    if method == 'pcrbm_array':
        # The cells work side by side: there the cycles count, not the operations of all cells,
        # and routes bring H to the rows of the array, not to one lane.
        sections |= {SECTION: solve_steps(robot.n), STREAMS: stream_steps(robot.n, p, network)}
    steps = sum(sections.values(), Steps())
    work = arithmetic(program.count(1, iterations=iterations or 1))
    units = processors_of(method, robot.n, p)
    return Run(
        qdd=result['qdd'],
        steps=steps,
        steps_by_section={name: own for name, own in sections.items() if own != Steps()},
        utilisation=work / (arithmetic(steps) * units) if arithmetic(steps) else 0.0,
        error=float(np.max(error, initial=0.0)),
        status=_status(result, printed, bool(np.all(error <= bound))),
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
    sizes: dict[str, int], given: dict[str, ArrayLike], digits: int | None
) -> dict[str, Any]:
    """Return the inputs as arrays of one batch shape; ValueError for a wrong one."""
    arrays = {}
    for name, size in sizes.items():
        array = real_array(name, given[name], 'float64', (..., size))
        arrays[name] = np.asarray(given[name], dtype=object) if digits else array
    shape = common_shape(arrays)
    return {
        name: np.broadcast_to(array, (*shape, array.shape[-1])) for name, array in arrays.items()
    }


def _error(
    qdd: NDArray[Any], found: dict[str, Any], free: NDArray[Any] | None, dtype: str
) -> tuple[NDArray[Any], NDArray[Any]]:
    """
    Return the error of accelerations, as in Run, and the largest of an answer that is right.

        bound = ROUNDINGS u cond(H), H scaled to ones on its diagonal;  at most CORRECTION
    """
    H, r, tau, qdd = (
        np.asarray(x, np.float64) for x in (found['H'], found['residual'], found['motors'], qdd)
    )
    one = np.eye(H.shape[-1])
    if free is not None:
        moves = np.asarray(free, np.float64) > 0
        H = np.where(moves[..., None] & moves[..., None, :], H, one)
        r, tau = np.where(moves, r, 0.0), np.where(moves, tau, 0.0)
    diagonal = np.diagonal(H, axis1=-2, axis2=-1)
    sound = np.logical_and(np.isfinite(H).all((-1, -2)), (diagonal > 0).all(-1))[..., None]
    scale = np.sqrt(np.where(sound, diagonal, 1.0))
    H = np.where(sound[..., None], H, one) / scale[..., None] / scale[..., None, :]
    values, vectors = np.linalg.eigh(H)

    def accelerations(torques: NDArray[Any]) -> Any:
        parts = ((torques / scale)[..., None, :] @ vectors)[..., 0, :] / values
        return abs((vectors @ parts[..., None])[..., 0] / scale).max(-1)

    with np.errstate(all='ignore'):
        missing = accelerations(r)
        error = missing / np.maximum(abs(qdd).max(-1), accelerations(tau))
        error = np.where(missing == 0, 0.0, np.where(sound[..., 0], error, np.inf))
        condition = abs(values).max(-1) / abs(values).min(-1)
        bound = ROUNDINGS * np.finfo(dtype).eps / 2 * condition
    return np.where(np.isnan(error), np.inf, error), np.minimum(bound, CORRECTION)


def _status(result: dict[str, Any], printed: bool, right: bool) -> str:
    def positive(*names: str) -> bool:
        """Return whether results are above zero, as far as the program has them."""
        found = (np.asarray(result[name], np.float64) for name in names if name in result)
        return all((values > 0).all() for values in found)

    if printed:
        return 'ok' if right else 'wrong'
    if not positive('pivots'):
        return 'not_positive_definite'
    if not np.isfinite(np.asarray(result['qdd'], np.float64)).all():
        return 'not_finite'
    if 'converged' not in result or (right and positive('converged')):
        return 'ok'
    return 'not_converged'
