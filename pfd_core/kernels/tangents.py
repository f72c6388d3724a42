# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Derivatives of a simulation's step: its scripts on dual numbers, one direction in each lane.

    array x                  values in all lanes, and behind them `x.d`, their tangents
    program or dynamics      its directional derivative, values and tangents
    @body1                   all directions, a register of them at a time, through some substeps

A step decides by values alone, which are the same in all lanes. So each lane takes the branches of
the simulation, and the result is the derivative of the numbers that the simulation computes, but
for events: their time depends on the state, and the step's writer adds what follows from it.

Names of arrays that only decide have no tangents. Programs without any run as they are.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
import hashlib
import math

from pfd_core.dynamics.joint_torques import record_joint_torques
from pfd_core.kernels.auto import select
from pfd_core.kernels.generate import (
    batch,
    declarations,
    evaluate,
    inputs_of,
    parameters,
)
from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.lower import joined, lower
from pfd_core.kernels.native import Optimisation, simd_width
from pfd_core.kernels.recipes import Facts, Recipe, digest
from pfd_core.kernels.script import Frame, Script
from pfd_core.kernels.simulate import MOTION, MOTOR_TORQUE, UNFINISHED, Steps, brake
from pfd_core.kernels.simulations import StepCode, step_dynamics
from pfd_core.kernels.sines import WRAP_LIMIT, wrap_angle
from pfd_core.kernels.spec import KernelSpec
from pfd_core.machine.derivative import directional
from pfd_core.machine.program import Program
from pfd_core.model.effects import JOINTS

# Of names: the tangents of an array.
TANGENT = '.d'
# Angles of at most this magnitude stay as they are [rad]: a stage rounds them little.
ANGLE_LIMIT = 8.0
# Joints that had an event in the step, 1 or 0.
HAPPENED = 'happened'


def of(name: str) -> str:
    """Return the name of the tangents of an array."""
    return name + TANGENT


class DualFrame(Frame):
    """Layout of arrays, each with its tangents behind it."""

    def place(self, name: str, size: int) -> int:
        """Return the first element of an array, which is added with its tangents if it is new."""
        base = name.removesuffix(TANGENT)
        if base not in self:
            super().place(f'{base}+', 2 * size)
            super().split(f'{base}+', base, of(base))
        return super().place(name, size)

    def split(self, name: str, *parts: str) -> None:
        """Name the equal parts of an array, and of its tangents."""
        super().split(name, *parts)
        super().split(of(name), *map(of, parts))


class DualScript(Script):
    """Writer of a function on dual numbers: whatever is done with an array is done with both."""

    parts = 2  # values and tangents

    def named(self, arrays: Mapping[str, str], names: Collection[str]) -> dict[str, str]:
        """Return the array of each input or output of a program."""
        found = {}
        for name in names:
            base = name.removesuffix(TANGENT)
            found[name] = arrays.get(base, base) + name[len(base) :]
        return found

    def fill(self, name: str, value: float, size: int) -> None:
        """Write equal elements to an array."""
        super().fill(name, value, size)
        super().fill(of(name), 0.0, size)

    def copy(self, source: str, target: str) -> None:
        """Copy an array."""
        super().copy(source, target)
        super().copy(of(source), of(target))


def dual(program: Program, constant: Collection[str]) -> Program:
    """
    Return a program with tangents, (...) after the values, of its outputs by its inputs.

    Inputs and outputs in `constant` have none.
    """
    inputs = [name for name in program.inputs if name not in constant]
    if not inputs or not program.outputs.keys() - constant:
        return program
    found = directional(program, list(program.outputs), inputs, of)
    off = {of(name) for name in constant}
    return replace(found, outputs={k: x for k, x in found.outputs.items() if k not in off})


class TangentSource(Recipe):
    """The source of a linearised step: a step's programs and dynamics on dual numbers."""

    def __init__(
        self,
        spec: KernelSpec,
        step: StepCode,
        substeps: int,
        constant: Collection[str],
        plain: Collection[str],
    ) -> None:
        self._step, self._substeps = step, substeps
        self._constant, self._plain = constant, plain
        self._sources, inputs = step_dynamics(spec, step)
        self._main = next(iter(self._sources.values()))
        self._n, self._dtype = spec.robot.n, spec.dtype
        sizes = dict.fromkeys(MOTION, self._n) | inputs
        self._inputs = {name: sizes[name] for name in inputs_of(Program(1, (), sizes, {}))}
        # The rows of the state that the motion depends on.
        self._rows = (*MOTION, *(name for name in step.further if name == MOTOR_TORQUE))
        rows = len(self._rows)
        self._shape = [self._n * rows, self._n * (rows + 1) + 1 + step.contact]
        keys = [str(source.key) for source in self._sources.values()]
        settings = f'{step.settings} {substeps} {step.plant.digest}'
        self.key = ('tangents', str(simd_width(spec.dtype)), settings, *keys)

    def _facts(self) -> Facts:
        own = [*self.key, *(source.facts.digest for source in self._sources.values())]
        own += [f'{name} {digest(program)}' for name, program in self._programs().items()]
        described = hashlib.sha256('\n'.join(own).encode()).hexdigest()
        operations = self._main.facts.operations
        return Facts(self._inputs, self._shape, operations, False, described)

    @property
    def work(self) -> int:
        """The operations of all substeps without events, of dual numbers roughly thrice."""
        blocks = -(-self._shape[1] // simd_width(self._dtype))
        return 3 * self._main.work * self._step.evaluations * self._substeps * blocks

    @property
    def optimisation(self) -> Optimisation:
        """The effort of the compiler."""
        return replace(self._main.optimisation, reorder=True)

    def _programs(self) -> dict[str, Program]:
        found = {}
        for name, program in self._step.programs().items():
            if name not in self._plain:
                program = dual(lower(program, self._dtype).folded, self._constant)
            found[name] = lower(program, self._dtype, fma=False).compiled
        return found

    def functions(self, dtype: str, width: int, angles: Sequence[int]) -> list[str]:
        """Return the functions of a kernel, whose batches go from state to state."""
        step, plant, n = self._step, self._step.plant, self._n
        inputs = {name: size for name, size in self._inputs.items() if name not in MOTION}
        steps = Steps(n, step.further, inputs, (), dtype, width, step.shared)
        dynamics = {
            name: lower(joined(dual(source.lowered.folded, self._constant)), dtype).compiled
            for name, source in self._sources.items()
        }
        frame = DualFrame()
        for name, size in (dict.fromkeys((*steps.rows, 'qdd'), n) | inputs).items():
            frame.place(name, size)
        # Torques of springs and cogging change from turn to turn, and so do stops.
        turns = 'q' in record_joint_torques(plant.only(JOINTS)).inputs
        wrapped = () if turns or plant.joint_limits is not None else angles
        functions = step.write(steps, self._programs(), dynamics, frame, angles)
        if 'free' in inputs:
            functions.append(brake(DualScript('brake', frame, dynamics, dtype, width), n, TANGENT))
        signature, size = Program(1, (), self._inputs, {}), math.prod(self._shape)
        functions += [
            self._body(steps, frame, wrapped),
            evaluate(signature, dtype, 1, ()),
            batch(signature, dtype, 1, size),
            declarations(dtype, {1, width}, False),
        ]
        return functions + [wrap_angle(ANGLE_LIMIT if wrapped else WRAP_LIMIT)] * bool(angles)

    def _body(self, steps: Steps, frame: DualFrame, angles: Sequence[int]) -> str:
        """
        Return `void @body1(inputs..., out)`: substeps in all directions, a register at a time.

        Of `angles`, elements of q, only the part within half a turn enters the stages: a stage
        would round a large angle. The turns are added to the angle at the end.
        """
        head = f'define internal void @body1({parameters([*self._inputs, "out"])})'
        s = Script('body1', frame, {}, steps.dtype, steps.width, head=head)
        code, n, width, bytes_ = s.code, steps.n, steps.width, s.code.bytes
        zero, one = code.constant(0.0), code.constant(1.0)

        def number(place: str) -> str:
            return code.load(code.scalar, place, bytes_)

        given = {
            name: [number(code.at(f'%{name}', k, f'%{name}.s')) for k in range(size)]
            for name, size in self._inputs.items()
        }
        turns = {}
        for k in angles:
            angle = code.call('double', 'wrap_angle', f'double {given["q"][k]}')
            turns['q', k] = code.let(f'fsub double {given["q"][k]}, {angle}')
            given['q'][k] = angle
        values = {name: [code.spread(x) for x in own] for name, own in given.items()}
        if MOTOR_TORQUE in self._rows:
            values[MOTOR_TORQUE] = values['tau']
        further = [name for name in (HAPPENED, UNFINISHED) if name in frame]
        values |= {name: [zero] * n for name in further}
        directions = [(name, k) for name in (*self._rows, 'tau') for k in range(n)]
        ends, m, columns = directions[:-n], len(directions), self._shape[1]
        lanes = ', '.join(f'i64 {lane}' for lane in range(width))
        with code.loop(m, step=width) as first:
            for name, own in values.items():
                s.write(name, own)
            # The direction in each lane.
            begun = code.let(f'insertelement {code.index} poison, i64 {first}, i64 0')
            begun = code.shuffle(code.index, begun, 'poison', [0] * width)
            here = code.let(f'add {code.index} {begun}, <{lanes}>')
            for k, (name, joint) in enumerate(directions):
                flags = code.let(f'icmp eq {code.index} {here}, splat (i64 {k})')
                code.write(code.choose(flags, one, zero), s.at(of(name), k=joint), 0, 0)
            for function in ['brake'] * ('free' in steps.inputs) + ['accelerate'] * steps.shared:
                s.call(function)
            with code.loop(self._substeps):
                s.call('advance')
            count = code.least(width, code.integer('sub', m, first))
            for i, (name, k) in enumerate(ends):
                source, row = s.at(of(name), k=k), code.at('%out', i * columns, '%out.s')
                with code.loop(count) as lane:
                    place = code.at(row, code.integer('add', first, lane), '%out.s')
                    value = number(code.at(source, lane, bytes_))
                    code.store(code.scalar, value, place, bytes_)
        last = [(m, ends), (m + 1, [(name, k) for name in further for k in range(n)])]
        for column, results in last:
            for i, (name, k) in enumerate(results):
                value = number(s.at(name, k=k))
                if (name, k) in turns:
                    value = code.let(f'fadd double {value}, {turns[name, k]}')
                place = code.at('%out', i * columns + column, '%out.s')
                code.store(code.scalar, value, place, bytes_)
        return str(s)


def compile_tangents(
    spec: KernelSpec,
    step: StepCode,
    substeps: int,
    constant: Collection[str],
    plain: Collection[str],
) -> Kernel:
    """
    Compile the linearisation of some substeps, a kernel of q, qd and tau.

    The spec is of a STEP in float64. Its method gives way to one whose H^-1 is accurate on this
    robot, as for derivatives of accelerations; the accelerations are the same but for rounding.
    The functions of the step are written by DualScript; its positions are plain sums, since the
    digits that these lose have no derivative. Arrays in `constant` have no tangents, and programs
    in `plain` run as they are.

    The kernel's result, (r n, (r + 1) n + 1), is the derivative of the r rows of the state at the
    end by those at the beginning and by the torque, and then the state at the end. Of a step with
    events there is one more column: the array HAPPENED, and behind it 1 if there were too many
    events. Motors with a lag have reached the torque at the beginning.
    """
    method, refine = select(spec.plant, use='derivatives')
    own = replace(spec, method=method, refine=refine)
    source = TangentSource(own, step, substeps, constant, plain)
    return Kernel(spec, source, partial(compile_tangents, spec, step, substeps, constant, plain))
