# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR to native code in this process.

    native = compile_kept(key, source, ['f'], Facts)    native['f'] is the address of a function
    code = emit(ir, target)                             an object file, for any processor

The code is for the processor of this machine, or for the level of x86-64 that the environment
variable PFD_TARGET_CPU names, which is read at each compilation. Results have the same bits on
every processor: no option lets LLVM change one, and without a fused multiply-add it calls `fma`
of the C library, which C99 requires to round once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache
import logging
import os
import time
from typing import Any

import llvmlite
import llvmlite.binding as llvm

from pfd_core.forking import hold_at_fork
from pfd_core.kernels.cache import kept

# A record for each module that the compiler is run on.
COMPILE_LOG = logging.getLogger('pfd_core.compile')
VARIABLE = 'PFD_TARGET_CPU'
_V2 = ('cx16', 'popcnt', 'sahf', 'sse3', 'sse4.1', 'sse4.2', 'ssse3')
_V3 = (*_V2, 'avx', 'avx2', 'bmi', 'bmi2', 'f16c', 'fma', 'lzcnt', 'movbe')
_V4 = (*_V3, 'avx512bw', 'avx512cd', 'avx512dq', 'avx512f', 'avx512vl')
# The features that a machine needs, by LLVM's names.
LEVELS = {'x86-64-v2': _V2, 'x86-64-v3': _V3, 'x86-64-v4': _V4}
# IR passes that are worth their time around straight-line code, which is as short as it gets.
PASSES = ('always_inliner', 'sroa', 'simplify_cfg', 'global_dead_code_eliminate')
# Held by llvmlite during each call of LLVM, reentrant; None if an llvmlite has no such lock.
LLVM_LOCK = getattr(llvm.ffi.lib, '_lock', None)
# The newest LLVM that is known to have the option: LLVM ends the process at an unknown one.
NEWEST_WITH_SCHEDULER_OPTION = 22
# Addresses in this process, which stay valid, to which every module may refer by their names.
SYMBOLS: dict[str, int] = {}


@dataclass(frozen=True)
class Target:
    """A processor to compile for, as LLVM describes it."""

    triple: str  # architecture, vendor and system
    cpu: str = ''  # name of the processor
    features: str = ''  # its extensions

    @property
    def vector_bits(self) -> int:
        """Bits in one vector register: AVX-512, AVX, or NEON and SSE2."""
        on = set(self.features.split(','))
        return 512 if '+avx512f' in on else 256 if '+avx' in on else 128


@dataclass(frozen=True)
class Optimisation:
    """How hard LLVM tries; the bits of a result do not depend on it."""

    # For a long program, in which LLVM finds little to do and takes its time. Thirty joints: half
    # the time to compile, and code within 5 % of the usual speed.
    long: bool = False
    # Whether LLVM may reorder operations; for code that is not ordered already
    # (pfd_core.kernels.schedule). With 16 vector registers LLVM always reorders. Where there are
    # 32, its level 1 writes derivatives in a fifth less time than level 2, and they are 1 to 2 %
    # faster; batches of ordered code are 3 % slower.
    reorder: bool = True
    # Whether the code has many branches, as steps with events: a further pass makes these 6 %
    # faster. It takes half the time of all passes, and changes nothing elsewhere.
    branches: bool = False


@dataclass(frozen=True)
class Native:
    """Native code of a module, which is freed with its last owner."""

    library: Any
    facts: Any  # kept with it, see compile_kept
    seconds: float  # time to compile or to load it

    def __getitem__(self, name: str) -> int:
        """Return the address of a function."""
        return int(self.library[name])


def current() -> Target:
    """Return the processor to compile for; ValueError for an unknown or unfit PFD_TARGET_CPU."""
    level = os.environ.get(VARIABLE, '').strip()
    if not level:
        return host()
    if level not in LEVELS:
        raise ValueError(
            f'{VARIABLE} must be empty, for this machine, or one of {", ".join(LEVELS)}, '
            f'got {level!r}'
        )
    if missing := missing_features(level):
        raise ValueError(
            f'{VARIABLE} must name a processor whose code runs on this machine '
            f'({host().cpu}), got {level!r}, which needs {", ".join(missing)}'
        )
    return level_target(level)


@cache
def host() -> Target:
    """Return the processor of this machine."""
    return _target(llvm.get_host_cpu_name(), _features_of_machine())


def level_target(level: str) -> Target:
    """Return a level of x86-64, which this machine need not have."""
    return _target(level, dict.fromkeys(LEVELS[level], True))


def missing_features(level: str) -> list[str]:
    """Return what a level of x86-64 has and this machine lacks."""
    here = _features_of_machine()
    return [name for name in LEVELS[level] if not here.get(name)]


def _features_of_machine() -> dict[str, bool]:
    """Return the features that LLVM knows, and whether this machine has them."""
    try:
        return dict(llvm.get_host_cpu_features())
    except RuntimeError:  # LLVM cannot query every processor; the name is enough then
        return {}


def _target(cpu: str, features: dict[str, bool]) -> Target:
    """Return a processor of this machine's kind, whose widest registers are used."""
    if features.get('avx512f'):
        features = features | {'prefer-256-bit': False}
    flat = ','.join(f'{"+" if on else "-"}{name}' for name, on in sorted(features.items()))
    return Target(llvm.get_process_triple(), cpu, flat)


def simd_width(dtype: str, target: Target | None = None) -> int:
    """Return how many numbers one vector register holds; by default, of the current target."""
    bits = (current() if target is None else target).vector_bits
    return bits // (64 if dtype == 'float64' else 32)


def compile_kept(
    key: Sequence[str],
    source: Callable[[], tuple[str, Optimisation, dict[str, Any]]],
    functions: Sequence[str],
    facts: Callable[..., Any],
) -> Native:
    """
    Return native code of a module, from disk if it was compiled before.

    The key is everything that determines what `source` returns: the IR, how hard to try, and a
    JSON object that is kept with the code, whose members make `facts`. `functions` are those whose
    addresses are needed.
    """
    target, seconds = current(), 0.0

    def make() -> tuple[dict[str, Any], bytes]:
        nonlocal seconds
        ir, optimisation, own = source()
        COMPILE_LOG.info('compiling %s', ', '.join(functions))
        start = time.perf_counter()
        code = emit(ir, target, optimisation)
        seconds = time.perf_counter() - start
        return own, code

    versions = llvmlite.__version__, str(llvm.llvm_version_info)
    head, code = kept((*key, *versions, repr(target)), make)
    start = time.perf_counter()
    # JITLink places code, constants and table next to each other. Each module has its own
    # linker, because a common one would not free everything.
    linker = llvm.create_lljit_compiler(_machine(target), use_jit_link=True)
    builder = llvm.JITLibraryBuilder().add_object_img(code).add_current_process()
    for name, address in SYMBOLS.items():
        builder.import_symbol(name, address)
    for name in functions:
        builder.export_symbol(name)
    library = builder.link(linker, 'kernel')
    return Native(library, facts(**head), seconds + time.perf_counter() - start)


def emit(ir: str, target: Target | None = None, optimisation: Optimisation | None = None) -> bytes:
    """
    Return the object file of a module of LLVM IR.

    The target, by default the current one, need not be this machine's. RuntimeError if the IR is
    not a valid module, or this LLVM cannot compile for the target.
    """
    target, optimisation = target or current(), optimisation or Optimisation()
    machine = _machine(target, 1 if optimisation.long or optimisation.reorder else 2)
    module = llvm.parse_assembly(ir)
    module.triple = target.triple
    module.data_layout = str(machine.target_data)
    module.verify()
    _optimise(module, machine, ir, optimisation)
    with nullcontext() if optimisation.reorder or target.vector_bits < 512 else _order_kept():
        return bytes(machine.emit_object(module))


def _machine(target: Target, level: int = 2) -> Any:
    # Constants are next to the code, in reach of an instruction; only symbols of the process
    # are reached through a table.
    return llvm.Target.from_triple(target.triple).create_target_machine(
        cpu=target.cpu, features=target.features, opt=level, reloc='pic', codemodel='small'
    )


def _optimise(module: Any, machine: Any, ir: str, optimisation: Optimisation) -> None:
    options = llvm.create_pipeline_tuning_options(speed_level=0)
    # No scalars or loops become vectors.
    options.slp_vectorization = options.loop_vectorization = False
    builder = llvm.create_pass_builder(machine, options)
    passes = llvm.create_new_module_pass_manager()
    for name in ['sroa'] if optimisation.long else PASSES:
        getattr(passes, f'add_{name}_pass')()
        if name == 'sroa' and optimisation.branches and not optimisation.long:
            passes.add_instruction_combine_pass()
    # `always_inliner` inlines what is called in one place; LLVM would weigh costs.
    for function in module.functions:
        words = b' '.join(function.attributes).split()
        once = ir.count(f'@{function.name}(') == 2
        if function.linkage == llvm.Linkage.internal and once and b'noinline' not in words:
            function.add_function_attribute('alwaysinline')
    passes.run(module, builder)
    # llvmlite 0.50 frees no pass manager: the empty method of ObjectRef hides its own.
    hidden = getattr(super(llvm.ffi.ObjectRef, passes), '_dispose', None)
    if hidden is not None:
        hidden()
        passes.detach()


@contextmanager
def _order_kept() -> Iterator[None]:
    """
    Switch off LLVM's scheduler of machine instructions.

    The option is global: the lock keeps other users of llvmlite, such as Numba, from compiling
    meanwhile. Without the lock, or with an LLVM that may not have the option, the scheduler stays
    on: code is then slower by some percent and computes the same bits.
    """
    if LLVM_LOCK is None or llvm.llvm_version_info[0] > NEWEST_WITH_SCHEDULER_OPTION:
        yield
        return
    with LLVM_LOCK:
        llvm.set_option('pfd_core', '-enable-misched=false')
        try:
            yield
        finally:
            llvm.set_option('pfd_core', '-enable-misched=true')


llvm.initialize_native_target()
llvm.initialize_native_asmprinter()
# A process forks between two calls of LLVM, never during one.
hold_at_fork(LLVM_LOCK or nullcontext())
