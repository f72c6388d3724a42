# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Time of an evaluation of forward dynamics over its error, at ordinary and hard cases.

Each point is a method, number format and number of refinement steps, or a peer, with a batch
size: seconds for each state, and the largest error over the states of the case. Cases, references
of 50 digits and condition numbers are taken from the hard cases; errors from the native kernels.
At one case and batch size all ways take turns in one process.

A batch repeats the states of the case; a state has the same bits alone and in a batch. Pinocchio's
function for batches works in WORLD axes only: called from Python, LOCAL axes and CRBA are a loop
in Python. Pinocchio's C++ and CasADi's C have native loops. Pinocchio's C++ is also measured with
a step of iterative refinement. A peer that warns of its result has failed and has no point.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfd_core.algorithms.programs import METHODS
from pfd_core.kernels.auto import default
from pfd_core.kernels.compile import compile_kernel
from pfd_core.kernels.kernel import Kernel
from pfd_core.model import Robot, resolve
from pfd_core.report.cases.hard_cases import CASES, ROUNDING, Case
from pfd_core.report.cases.problems import Problem
from pfd_core.report.cases.robots import Array
from pfd_core.report.contenders import ours, pinocchio_cpp
from pfd_core.report.contenders.casadi import Casadi
from pfd_core.report.contenders.mujoco import MUJOCO, Mujoco
from pfd_core.report.contenders.pinocchio import (
    EVALUATIONS,
    PYTHON_LOOP,
    SEVERAL,
    SINGLE,
    Pinocchio,
)
from pfd_core.report.contenders.work import (
    Contender,
    LeftOutError,
    Side,
    Work,
    one_by_one,
    valid_sides,
)
from pfd_core.report.measure.errors import CaseFacts, facts_of, methods, peer_answers
from pfd_core.report.measure.processes import each
from pfd_core.report.measure.progress import show_progress
from pfd_core.report.measure.reference import Reference, errors, kappa_j, kappa_s, reference
from pfd_core.report.measure.timing import Pace, interleave

BATCHES = (1, 4096)
REFINEMENTS = (0, 1)
CASADI = 'CasADi C'
# pinocchio_cpp.FUNCTIONS that are measured, by name.
NATIVE = {pinocchio_cpp.FUNCTIONS[key]: key for key in ('aba', 'crba', 'aba_refined')}
PEERS = (*EVALUATIONS, MUJOCO, *NATIVE, CASADI)
MAKERS: dict[str, Callable[[Robot], Contender]] = {
    'Pinocchio': Pinocchio,
    MUJOCO: Mujoco,
    pinocchio_cpp.NAME: pinocchio_cpp.PinocchioCpp,
    CASADI: Casadi,
}
# The most joints for a method whose kernels of more joints take minutes to compile.
MOST = {'divide_and_conquer': 7, 'composite_body': 30}


@dataclass(frozen=True)
class Plan:
    """Names of hard cases, methods, batch sizes, pace and peers of a measurement."""

    cases: tuple[str, ...] = (
        'ordinary_puma560',
        'ordinary_ur5',
        'ordinary_panda',
        'payload_1e6',
        'heavy_tip_1e8_n12',
        'near_stretched_40',
        'collinear_axes_1e-12',
    )
    methods: tuple[str, ...] = METHODS
    batches: tuple[int, ...] = BATCHES
    # Shorter chunks and more turns than elsewhere: ratios of a few percent matter here.
    pace: Pace = field(default_factory=lambda: Pace(chunk=1e-3, turns=100, fewest=10, budget=8.0))
    peers: tuple[str, ...] = tuple(MAKERS)


QUICK = Plan(
    cases=('ordinary_planar2', 'collinear_axes_1e-12'),
    methods=('composite_body', 'grouped_articulated_body', 'articulated_body', 'pcrbm'),
    batches=(1, 64),
    pace=Pace(chunk=1e-4, turns=3, fewest=2),
)


@dataclass(frozen=True)
class TimedCase(CaseFacts):
    """
    A case at which ways are timed.

    `auto` and `steps` are the method and the steps of refinement that 'auto' selects, `refined`
    the method that it selects for `refine=1`.
    """

    auto: str
    refined: str
    # Missing in older JSON files, from versions in which 'auto' never refined.
    steps: int = 0

    def default(self, refine: int) -> str:
        """Return the method of 'auto' with so many steps of refinement; '' if it takes more."""
        return self.refined if refine else '' if self.steps else self.auto


@dataclass(frozen=True)
class Point:
    """
    Time and error of one way at a case.

    Attributes
    ----------
    case, way : str
        Names of the case, and of a method of ours or a peer.
    dtype : str
        Number format.
    refine, batch : int
        Steps of refinement, and states in a call.
    minimum, median : float
        Seconds for each state.
    times : float or None
        Median over the turns of the time of the default kernel in float64 over the time of this
        way.
    error : float or None
        Largest error over the states of the case; None for an answer that is not finite.
    in_units : float or None
        Largest error over kappa_s u, u the rounding unit of the number format.
    code, call, loop : str
        What the time contains, as in Contents; '' in older JSON files, which lack it.

    """

    case: str
    way: str
    dtype: str
    refine: int
    batch: int
    minimum: float
    median: float
    times: float | None
    error: float | None
    in_units: float | None
    code: str = ''
    call: str = ''
    loop: str = ''

    @property
    def work(self) -> str:
        """Name of the work in a table."""
        return 'call' if self.batch == 1 else f'batch of {self.batch}'


@dataclass(frozen=True)
class Way:
    """A way to accelerations: how to time it on states, and its errors as Point has them."""

    name: str
    dtype: str
    refine: int
    side: Callable[[list[Array]], Side]
    error: float | None
    in_units: float | None


@dataclass(frozen=True)
class Solved:
    """The problem of a case, its reference, and kappa_s of each state, (S,)."""

    name: str
    problem: Problem
    known: Reference
    condition: Array

    def errors(self, answer: NDArray[Any], dtype: str) -> tuple[float | None, float | None]:
        """Return the largest error of qdd (S, n), and in kappa_s u; None for a lost answer."""
        found = errors(answer, self.known)
        if not np.isfinite(found).all():
            return None, None
        return float(np.max(found)), float(np.max(found / self.condition) / ROUNDING[dtype])


def compile_all(plan: Plan) -> None:
    """Compile kernels of all cases, and C++, on all processors; the disk cache keeps them."""
    kernels = [
        (name, method, dtype, refine)
        for name in plan.cases
        for method in _able(plan.methods, _case(name).make().plant.robot)
        for dtype in ROUNDING
        for refine in REFINEMENTS
    ]
    # The longest compilations begin first.
    kernels.sort(key=lambda kernel: kernel[1] not in MOST)
    jobs = [partial(_compile, *kernel) for kernel in kernels]
    if pinocchio_cpp.NAME in plan.peers:
        jobs.insert(0, partial(_compile_cpp))
    for _ in each(_done, jobs, 'compiling'):
        pass


def _done(job: Callable[[], None]) -> None:
    job()


def _compile_cpp() -> None:
    # The measurement reports why it cannot be compiled.
    with suppress(LeftOutError):
        pinocchio_cpp.compiled_library()


def _compile(name: str, method: str, dtype: str, refine: int) -> None:
    """Compile a kernel of a case for one state and for batches."""
    problem = _case(name).make()
    made = compile_kernel(problem.plant.robot, method=method, dtype=dtype, refine=refine)
    states = [np.atleast_2d(x) for x in problem.states.values()]
    for batch in (states, [x[0] for x in states]):
        made(*batch)


def _case(name: str) -> Case:
    (case,) = (case for case in CASES if case.name == name)
    return case


def _able(wanted: Sequence[str], robot: Robot) -> list[str]:
    """Return the methods whose kernels of this robot compile in less than minutes."""
    known = set(methods(robot.n))
    return [
        method for method in wanted if method in known and robot.n <= MOST.get(method, robot.n)
    ]


def measure(name: str, plan: Plan) -> tuple[TimedCase, list[Point], list[str]]:
    """Return a case, its points, and the excluded implementations with reasons."""
    case = _case(name)
    show_progress(f'{name}: reference')
    problem = case.make()
    known = reference(problem)
    solved = Solved(name, problem, known, kappa_s(problem, known))
    auto, steps = default(problem.plant, 'auto', 0)
    facts = TimedCase(
        **facts_of(case, problem, known, (solved.condition, kappa_j(problem))),
        auto=auto,
        steps=steps,
        refined=default(problem.plant, 'auto', 1)[0],
    )
    left_out: list[str] = []
    ways = [*_kernels(solved, plan.methods, left_out), *_peers(solved, plan.peers, left_out)]
    points: list[Point] = []
    for batch in plan.batches:
        reasons: dict[str, str] = {}
        points += _points(facts, ways, solved, batch, plan, reasons)
        left_out += [f'{way} at {name}: {reason}' for way, reason in reasons.items()]
    return facts, points, left_out


def _points(
    case: TimedCase,
    ways: Sequence[Way],
    solved: Solved,
    batch: int,
    plan: Plan,
    reasons: dict[str, str],
) -> Iterator[Point]:
    """Yield the points of all ways, which take turns, with so many states in a call."""
    show_progress(f'{case.name}: batch of {batch}')
    states: list[NDArray[Any]] = [
        np.resize(x, (batch, case.n)) for x in solved.problem.states.values()
    ]
    auto = (case.auto, 'float64', case.steps)
    pairs = []
    for way in ways:
        reference = (way.name, way.dtype, way.refine) == auto
        side = replace(way.side(states), way=way.name, reference=reference)
        pairs += [(way, valid) for valid in valid_sides([side], reasons)]
    sides = [side for _, side in pairs]
    for (way, side), times in zip(pairs, interleave(sides, batch, plan.pace), strict=True):
        yield Point(
            case.name,
            way.name,
            way.dtype,
            way.refine,
            batch,
            times.minimum,
            times.median,
            times.times,
            way.error,
            way.in_units,
            **vars(side.contents),
        )


def _kernels(solved: Solved, wanted: tuple[str, ...], left_out: list[str]) -> Iterator[Way]:
    """Yield the kernels of a case, in every number format, without and with refinement."""
    plant, states = solved.problem.plant, solved.problem.states
    robot = plant.robot
    if resolve(robot).digest != plant.digest:
        raise ValueError(f'{solved.name} has a scene: only robots under gravity are compiled here')
    able = _able(wanted, robot)
    left_out += [
        f'{method} at {solved.name}: takes minutes to compile for {robot.n} joints'
        for method in wanted
        if method not in able
    ]
    for method in able:
        for dtype in ROUNDING:
            for refine in REFINEMENTS:
                show_progress(f'{solved.name}: compiling {method} {dtype} refine={refine}')
                kernel = compile_kernel(robot, method=method, dtype=dtype, refine=refine)
                found = solved.errors(kernel(*states.values()), dtype)
                yield Way(method, dtype, refine, partial(_kernel_side, kernel), *found)


def _kernel_side(kernel: Kernel, states: list[Array]) -> Side:
    """Return a kernel that is bound to one state, or to a batch in Fortran order."""
    q, qd, tau = (np.asfortranarray(x).astype(kernel.dtype) for x in states)
    if len(q) == 1:
        q, qd, tau = q[0], qd[0], tau[0]
    out = np.empty_like(q)
    contents = ours.BOUND if q.ndim == 1 else ours.BATCH
    run = kernel.bind(q, qd, tau, out)
    return Side(kernel.method, run, partial(np.asarray, out), contents=contents)


def _peers(solved: Solved, peers: Sequence[str], left_out: list[str]) -> Iterator[Way]:
    """Yield the peers that are installed and take the robot of a case."""
    answers = dict(peer_answers(solved.problem))
    states = [np.ascontiguousarray(x) for x in solved.problem.states.values()]
    for peer, side in _peer_sides(solved.problem.plant.robot, solved.name, peers, left_out):
        if peer in (*NATIVE, CASADI):
            found = side(states)
            found.run()
            answers[peer] = np.atleast_2d(found.result()).copy()
        if peer in answers:
            refine = int(peer.endswith('refined'))
            yield Way(peer, 'float64', refine, side, *solved.errors(answers[peer], 'float64'))
        else:
            left_out.append(f'{peer} at {solved.name}: it refuses the robot')


def _peer_sides(
    robot: Robot, case: str, peers: Sequence[str], left_out: list[str]
) -> Iterator[tuple[str, Callable[[list[Array]], Side]]]:
    """Yield each peer's name, and how to time it on states."""
    for name in peers:
        show_progress(f'{case}: making {name}')
        try:
            peer = MAKERS[name](robot)
        except LeftOutError as reason:
            left_out.append(f'{name} at {case}: {reason}')
        except (ValueError, RuntimeError) as reason:
            left_out.append(f'{name} at {case}: it refuses the robot ({reason})')
        else:
            if isinstance(peer, Pinocchio):
                for label, evaluation in EVALUATIONS.items():
                    yield label, partial(_pinocchio_side, peer, evaluation)
            elif isinstance(peer, pinocchio_cpp.PinocchioCpp):
                for label in NATIVE:
                    yield label, partial(_side, peer, label)
            else:
                yield name, partial(_side, peer, '')


def _pinocchio_side(peer: Pinocchio, evaluation: str, states: list[Array]) -> Side:
    if len(states[0]) > 1 and evaluation.endswith('WORLD'):
        return _side(peer, '', states)
    rows = [tuple(row.copy() for row in state) for state in zip(*states, strict=True)]
    evaluate = peer.evaluations()[evaluation]
    result = partial(np.asarray, evaluate(*rows[0]))
    if len(rows) == 1:
        contents = SINGLE if 'aba' in evaluation else SEVERAL
        return Side(evaluation, partial(evaluate, *rows[0]), result, contents=contents)
    run = partial(one_by_one, evaluate, rows)
    return Side(evaluation, run, result, contents=PYTHON_LOOP)


def _side(peer: Contender, way: str, states: list[Array]) -> Side:
    """Return a peer's way, or its first, of one call or of a batch."""
    one = len(states[0]) == 1
    q, qd, tau = (x[0] for x in states) if one else states
    return peer.side(Work('call' if one else 'batch', q, qd, tau), way)
