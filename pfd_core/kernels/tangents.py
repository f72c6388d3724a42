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
    wrap_number,
)
from pfd_core.kernels.ir import Code
from pfd_core.kernels.kernel import Kernel
from pfd_core.kernels.lower import lower
from pfd_core.kernels.native import Optimisation, simd_width
from pfd_core.kernels.recipes import Facts, Recipe, digest
from pfd_core.kernels.script import Frame, Script
from pfd_core.kernels.simulate import MOTION, MOTOR_TORQUE, UNFINISHED, Steps
from pfd_core.kernels.simulations import StepCode, step_dynamics, step_inputs
from pfd_core.kernels.sines import WRAP_LIMIT, wrap_angle
from pfd_core.kernels.spec import KernelSpec
from pfd_core.machine.derivative import directional
from pfd_core.machine.program import Output, Program
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

    def evaluate(self, result: str, name: str, **arrays: str) -> None:
        """Evaluate dynamics, whose result are values and then tangents."""
        program = self._dynamics[name]
        (output,) = program.outputs.values()
        arrays = _with_tangents(arrays, inputs_of(program))
        places = [self.at(arrays[key], program.inputs[key]) for key in inputs_of(program)]
        places.append(self.at(result, len(output.places) // 2))
        self.code.call('void', f'evaluate_{name}', *(f'ptr {place}' for place in places))

    def run(self, name: str, **arrays: str) -> None:
        """Run a program."""
        program = self._programs[name]
        super().run(name, **_with_tangents(arrays, (*program.inputs, *program.outputs)))

    def fill(self, name: str, value: float, size: int) -> None:
        """Write equal elements to an array."""
        super().fill(name, value, size)
        super().fill(of(name), 0.0, size)

    def copy(self, source: str, target: str) -> None:
        """Copy an array."""
        super().copy(source, target)
        super().copy(of(source), of(target))


def _with_tangents(arrays: Mapping[str, str], names: Collection[str]) -> dict[str, str]:
    """Return the array for each input or output of a program."""
    found = {}
    for name in names:
        base = name.removesuffix(TANGENT)
        found[name] = arrays.get(base, base) + name[len(base) :]
    return found


def dual(program: Program, constant: Collection[str]) -> Program:
    """
    Return a program with tangents, (...) after the values, of its outputs by its inputs.

    Inputs and outputs in `constant` have none.
    """
    inputs = [name for name in program.inputs if name not in constant]
    outputs = [name for name in program.outputs if name not in constant]
    if not inputs or not outputs:
        return program
    found = directional(program, list(program.outputs), inputs)

    def spelled(name: str) -> str:
        return of(name[2:]) if name.startswith('d ') else name

    instructions = tuple(
        i._replace(data=((spelled(i.data[0][0]), i.data[0][1]),)) if i.op == 'input' else i
        for i in found.instructions
    )
    kept = {*program.outputs, *(f'd {name}' for name in outputs)}
    return replace(
        found,
        instructions=instructions,
        inputs={spelled(name): size for name, size in found.inputs.items()},
        outputs={spelled(name): x for name, x in found.outputs.items() if name in kept},
    )


def _dual_dynamics(recipe: Recipe, constant: Collection[str], dtype: str) -> Program:
    """Return lowered dynamics whose one output are values and then tangents."""
    found = dual(recipe.lowered.folded, constant)
    name = next(iter(found.outputs))
    places = tuple(place for output in found.outputs.values() for place in output.places)
    if len(found.outputs) == 1:
        # No input varies.
        raise ValueError(f'dynamics without a derivative: {list(found.inputs)}')
    return lower(replace(found, outputs={name: Output((len(places),), places)}), dtype).compiled


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
        self._sources = step_dynamics(spec, step)
        self._main = main = next(iter(self._sources.values()))
        self._n, self._dtype = spec.robot.n, spec.dtype
        sizes = dict.fromkeys(MOTION, self._n) | step_inputs(main, step.plant)
        self._inputs = {name: sizes[name] for name in inputs_of(Program(1, (), sizes, {}))}
        keys = [str(source.key) for source in self._sources.values()]
        settings = f'{step.settings} {substeps} {step.plant.digest}'
        self.key = ('tangents', str(simd_width(spec.dtype)), settings, *keys)

    @property
    def _rows(self) -> tuple[str, ...]:
        """The rows of the state that the motion depends on."""
        return (*MOTION, *(name for name in self._step.further if name == MOTOR_TORQUE))

    @property
    def _shape(self) -> tuple[int, int]:
        rows = len(self._rows)
        return self._n * rows, self._n * (rows + 1) + 1 + self._step.contact

    def _facts(self) -> Facts:
        own = [*self.key, *(source.facts.digest for source in self._sources.values())]
        own += [f'{name} {digest(program)}' for name, program in self._programs().items()]
        described = hashlib.sha256('\n'.join(own).encode()).hexdigest()
        operations = self._main.facts.operations
        return Facts(self._inputs, list(self._shape), operations, False, described)

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
        """Return the lowered programs of the step."""
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
            name: _dual_dynamics(source, self._constant, dtype)
            for name, source in self._sources.items()
        }
        frame = DualFrame()
        for name, size in (dict.fromkeys((*steps.rows, 'qdd'), n) | inputs).items():
            frame.place(name, size)
        # Torques of springs and cogging change from turn to turn, and so do stops.
        turns = 'q' in record_joint_torques(plant.only(JOINTS)).inputs
        wrapped = () if turns or plant.joint_limits is not None else angles
        signature, size = Program(1, (), self._inputs, {}), math.prod(self._shape)
        functions = [
            *step.write(steps, self._programs(), dynamics, frame, angles),
            _Body(steps, self._rows, frame, self._inputs).written(self._substeps, wrapped),
            evaluate(signature, dtype, 1, ()),
            batch(signature, dtype, 1, size),
            declarations(dtype, {1, width}, False),
        ]
        return functions + [wrap_angle(ANGLE_LIMIT if wrapped else WRAP_LIMIT)] * bool(angles)


def compile_tangents(
    spec: KernelSpec,
    step: StepCode,
    substeps: int,
    constant: Collection[str],
    plain: Collection[str],
) -> Kernel:
    """
    Compile the linearisation of some substeps, a kernel of q, qd and tau.

    Parameters
    ----------
    spec : KernelSpec
        Of a STEP, in float64. Its method gives way to one whose H^-1 is accurate on this robot, as
        for derivatives of accelerations; the accelerations are the same but for rounding.
    step : StepCode
        A step whose functions are written by DualScript, with a function @brake if it has brakes;
        its positions are plain sums, since the digits that these lose have no derivative.
    substeps : int
        Steps of the integrator.
    constant : collection of str
        Arrays without tangents.
    plain : collection of str
        Programs that run as they are.

    Returns
    -------
    Kernel
        Its result, (r n, (r + 1) n + 1), is the derivative of the r rows of the state at the end
        by those at the beginning and by the torque, and then the state at the end. Of a step with
        events there is one more column: the array HAPPENED, and behind it 1 if there were too many
        events. Motors with a lag have reached the torque at the beginning.

    """
    method, refine = select(spec.plant, use='derivatives')
    own = replace(spec, method=method, refine=refine)
    source = TangentSource(own, step, substeps, constant, plain)
    return Kernel(spec, source, partial(compile_tangents, spec, step, substeps, constant, plain))


class _Body:
    """Writer of @body1, on arrays of a frame."""

    def __init__(
        self, steps: Steps, rows: Sequence[str], frame: DualFrame, inputs: Mapping[str, int]
    ) -> None:
        self._steps, self._rows, self._frame, self._inputs = steps, rows, frame, inputs
        head = f'define internal void @body1({parameters([*inputs, "out"])})'
        self._code = code = Code(head, steps.dtype, steps.width)
        self._near, self._step = code.array(frame.size), steps.width * code.bytes

    def written(self, substeps: int, angles: Sequence[int]) -> str:
        """
        Return `void @body1(inputs..., out)`: substeps along all directions, a register at a time.

        Of `angles`, elements of q, only the part within half a turn enters the stages: a stage
        would round a large angle. The turns are added to the angle at the end.
        """
        code, steps, n = self._code, self._steps, self._steps.n
        given = {
            name: [self._number(f'%{name}', k, f'%{name}.s') for k in range(size)]
            for name, size in self._inputs.items()
        }
        turns = self._wrap(given['q'], angles)
        if MOTOR_TORQUE in self._rows:
            given[MOTOR_TORQUE] = given['tau']
        further = [name for name in (HAPPENED, UNFINISHED) if name in self._frame]
        given |= {name: [Code('', steps.dtype).constant(0.0)] * n for name in further}
        directions = [(name, k) for name in (*self._rows, 'tau') for k in range(n)]
        m, columns = len(directions), len(directions) + 1 + bool(further)
        seeds = code.array(m)
        with code.loop(m, step=steps.width) as first:
            for name, values in given.items():
                for k, value in enumerate(values):
                    code.write(code.spread(value), self._at(name, k), 0, 0)
            count = self._seed(seeds, m, first)
            for k, (name, joint) in enumerate(directions):
                code.write(code.read(seeds, k, self._step), self._at(of(name), joint), 0, 0)
            before = ['brake'] * ('free' in steps.inputs) + ['accelerate'] * steps.shared
            for function in before:
                code.call('void', function, f'ptr {self._near}')
            with code.loop(substeps):
                code.call('void', 'advance', f'ptr {self._near}')
            for i, (name, k) in enumerate(directions[:-n]):
                source, row = self._at(of(name), k), code.at('%out', i * columns, '%out.s')
                with code.loop(count) as lane:
                    value = self._number(source, lane, code.bytes)
                    place = code.at(row, code.integer('add', first, lane), '%out.s')
                    code.store(code.scalar, value, place, code.bytes)
        for i, (name, k) in enumerate(directions[:-n]):
            value = self._number(self._at(name, k), 0, 0)
            if name == 'q' and k in turns:
                value = code.let(f'fadd {code.scalar} {value}, {turns[k]}')
            self._write(value, i * columns + m)
        for i, (name, k) in enumerate((name, k) for name in further for k in range(n)):
            self._write(self._number(self._at(name, k), 0, 0), i * columns + m + 1)
        code.ret()
        return str(code)

    def _at(self, name: str, k: int) -> str:
        """Return the address of an element of an array of the frame."""
        first = self._frame.place(name, self._frame.length(name))
        return self._code.at(self._near, first + k, self._step)

    def _number(self, base: str, k: object, stride: object) -> str:
        return self._code.load(self._code.scalar, self._code.at(base, k, stride), self._code.bytes)

    def _write(self, value: str, k: int) -> None:
        place = self._code.at('%out', k, '%out.s')
        self._code.store(self._code.scalar, value, place, self._code.bytes)

    def _seed(self, seeds: str, m: int, first: str) -> str:
        """Write the unit vectors from number `first` on; return how many lanes have one."""
        code = self._code
        for k in range(m):
            code.write(code.constant(0.0), seeds, k, self._step)
        count = code.least(code.width, code.integer('sub', m, first))
        with code.loop(count) as lane:
            row = code.at(seeds, code.integer('add', first, lane), self._step)
            one = Code('', code.dtype).constant(1.0)
            code.store(code.scalar, one, code.at(row, lane, code.bytes))
        return count

    def _wrap(self, q: list[str], angles: Sequence[int]) -> dict[int, str]:
        """Wrap the angles among the positions; return what each of them has lost."""
        code, turns = self._code, {}
        near = code.array(1, code.scalar)
        limit = Code('', code.dtype).constant(ANGLE_LIMIT)
        for k in angles:
            code.store(code.scalar, q[k], near)
            one = Code('', code.dtype)
            size = code.let(f'call {code.scalar} @llvm.fabs.{one.suffix}({code.scalar} {q[k]})')
            with code.when(code.let(f'fcmp ugt {code.scalar} {size}, {limit}'), rarely=True):
                wrap_number(code, near)
            value = code.load(code.scalar, near)
            turns[k] = code.let(f'fsub {code.scalar} {q[k]}, {value}')
            q[k] = value
        return turns
