# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Compile LLVM IR to native code in this process.

No option lets the code generator change a result: no fast-math flags, no contraction of a
multiplication and an addition into one. All processors compute the same bits.

Objects are kept on disk (pfd_core.kernels.runtime.disk_cache) under everything that decides them.
A fresh object and one from disk are linked into the process in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from functools import cache
import logging
import re
import time
from typing import Any

import llvmlite
import llvmlite.binding as llvm

from pfd_core.forking import hold_at_fork
from pfd_core.kernels.runtime import disk_cache as disk
from pfd_core.kernels.runtime import processor
from pfd_core.kernels.runtime.processor import Target

# A record for each module that the compiler is run on.
COMPILE_LOG = logging.getLogger('pfd_core.compile')
# The definition of a function that a module exports.
EXPORTED = re.compile(r'^define (?!internal )[^@\n]*@([\w.]+)\(', re.MULTILINE)
# Bytes of an object that depend on its target alone, by its first four bytes: ELF (up
# to e_machine) and Mach-O (up to filetype). COFF begins with the machine.
HEADER_BYTES = {b'\x7fELF': 20, b'\xcf\xfa\xed\xfe': 16}
COFF_MACHINE = 2
# Held by llvmlite during each call of LLVM, reentrant; None if an llvmlite has no such lock.
LLVM_LOCK = getattr(llvm.ffi.lib, '_lock', None)
# The newest LLVM that is known to have the option: LLVM ends the process at an unknown one.
NEWEST_WITH_SCHEDULER_OPTION = 22
# IR passes that are worth their time around straight-line code.
PASSES = (
    'always_inliner',
    'sroa',
    'instruction_combine',
    'simplify_cfg',
    'global_dead_code_eliminate',
)
# Addresses in this process that a module may refer to, by their names.
_symbols: dict[str, int] = {}


@dataclass(frozen=True)
class Outline:
    """The facts about a module of LLVM IR by which its object is found and linked."""

    digest: str  # SHA-256 of the IR
    functions: Sequence[str]  # the functions that it exports


@dataclass(frozen=True)
class Native:
    """Native code of one module."""

    seconds: float  # time to compile it, or to load it from disk
    library: Any  # owner of the code
    digest: str  # SHA-256 of its IR

    def address(self, name: str) -> int:
        """Return the address of a function."""
        return int(self.library[name])


@dataclass(frozen=True)
class Optimisation:
    """
    How hard LLVM tries; the bits of a result do not depend on it.

    Every option is a field, because the fields are part of an object's name on disk. The
    default cleans up around the straight-line code, which is already as short as it gets: LLVM's
    level 1 takes twice the time to compile and changes its speed by 2 % at most. Code with many
    branches keeps level 1, which makes it 4 to 7 % faster.

    Attributes
    ----------
    passes : tuple of str
        The IR passes, in their order; no functions are inlined without `always_inliner`.
    pipeline : int
        Level of LLVM's pipeline, which replaces `passes`: for code with many branches or loops
        over small matrices. 0 for `passes`.
    code : int
        Level of the code generator.
    long_ir, long_code : int
        Length from which IR is long, and the level of the code generator for long IR:
        derivatives of thirty joints are as fast, and made in three quarters of the time.
    relocation, code_model : str
        How code refers to its constants, and to symbols outside the module.
    reorder : bool
        Whether LLVM may reorder operations; set it for code that is not ordered already
        (pfd_core.kernels.passes.schedule). With 16 vector registers LLVM always reorders.

    """

    passes: tuple[str, ...] = PASSES
    pipeline: int = 0
    code: int = 2
    long_ir: int = 4_000_000
    long_code: int = 1
    relocation: str = 'pic'
    code_model: str = 'small'
    reorder: bool = True


USUAL = Optimisation()


def with_pipeline(optimisation: Optimisation) -> Optimisation:
    """Return the options with LLVM's pipeline of level 1 instead of passes, if they have any."""
    return replace(optimisation, pipeline=1) if optimisation.passes else optimisation


def outline(ir: str) -> Outline:
    """Return the outline of a module."""
    return Outline(disk.digest(ir), EXPORTED.findall(ir))


def compile_ir(ir: str) -> Native:
    """Return native code of a module of LLVM IR, from disk if it was compiled before."""
    return compile_outlined(outline(ir), lambda: ir)


def compile_outlined(
    known: Outline, ir: Callable[[], str], optimisation: Optimisation = USUAL
) -> Native:
    """Return native code of a module; its IR is written only if its object is not on disk."""
    start = time.perf_counter()
    target = processor.current()
    entry = disk.read(object_key(known.digest, target, optimisation))
    library = None if entry is None else _load_entry(entry, known.functions, target)
    if library is None:
        # Not the known outline, in case the source that writes the IR was edited meanwhile.
        known = outline(text := ir())
        COMPILE_LOG.info('compiling %s', ', '.join(known.functions))
        code = emit(text, target, optimisation)
        disk.write(object_key(known.digest, target, optimisation), code)
        library = _load(code, known.functions, target)
    return Native(time.perf_counter() - start, library, known.digest)


def object_key(digest: str, target: Target, optimisation: Optimisation) -> str:
    """Return the name of an object on disk: a digest of everything that decides its bytes."""
    versions = f'llvmlite {llvmlite.__version__} LLVM {llvm.llvm_version_info}'
    return disk.digest('object', versions, repr(target), repr(optimisation), digest)


def emit(ir: str, target: Target, optimisation: Optimisation = USUAL) -> bytes:
    """
    Return the object file of a module of LLVM IR.

    Parameters
    ----------
    ir : str
        The module.
    target : Target
        The processor, which need not be this machine's.
    optimisation : Optimisation
        How hard to try.

    Raises
    ------
    RuntimeError
        If the IR is not a valid module, or this LLVM cannot compile for the target.

    """
    if len(ir) >= optimisation.long_ir:
        optimisation = replace(optimisation, code=optimisation.long_code)
    machine = _machine(target, optimisation)
    module = llvm.parse_assembly(ir)
    module.triple = target.triple
    module.data_layout = str(machine.target_data)
    module.verify()
    _optimise(module, machine, optimisation)
    with nullcontext() if optimisation.reorder or target.vector_bits < 512 else _order_kept():
        return bytes(machine.emit_object(module))


def add_symbol(name: str, address: int) -> None:
    """Let modules refer to an address of this process by name."""
    _symbols[name] = address


def simd_width(dtype: str, target: Target | None = None) -> int:
    """Return how many numbers one vector register holds; by default, of the current target."""
    bits = (processor.current() if target is None else target).vector_bits
    return bits // (64 if dtype == 'float64' else 32)


@cache
def _initialise(triple: str) -> None:
    """Load LLVM's code generator for a target."""
    if triple == llvm.get_process_triple():
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
    else:
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()


def _machine(target: Target, optimisation: Optimisation) -> Any:
    _initialise(target.triple)
    # Constants are next to the code, in reach of an instruction; only symbols of the process
    # are reached through a table.
    return llvm.Target.from_triple(target.triple).create_target_machine(
        cpu=target.cpu,
        features=target.features,
        opt=optimisation.code,
        reloc=optimisation.relocation,
        codemodel=optimisation.code_model,
    )


def _optimise(module: Any, machine: Any, optimisation: Optimisation) -> None:
    options = llvm.create_pipeline_tuning_options(speed_level=optimisation.pipeline)
    # No scalars or loops become vectors.
    options.slp_vectorization = options.loop_vectorization = False
    builder = llvm.create_pass_builder(machine, options)
    if optimisation.pipeline:
        passes = builder.getModulePassManager()
    else:
        if optimisation.passes:
            _inline_internal(module)
        passes = llvm.create_new_module_pass_manager()
        for name in optimisation.passes:
            getattr(passes, f'add_{name}_pass')()
    passes.run(module, builder)
    # llvmlite 0.50 frees no pass manager: the empty method of ObjectRef hides its own.
    hidden = getattr(super(llvm.ffi.ObjectRef, passes), '_dispose', None)
    if hidden is not None:
        hidden()
        passes.detach()


def _inline_internal(module: Any) -> None:
    """
    Mark functions for `always_inliner`, where LLVM would weigh costs.

    A function that is only called in its module is inlined, unless it says `noinline`, as parts
    of long programs and functions that are rarely called do.
    """
    for function in module.functions:
        words = {word for attribute in function.attributes for word in attribute.split()}
        if function.linkage == llvm.Linkage.internal and b'noinline' not in words:
            function.add_function_attribute('alwaysinline')


@contextmanager
def _order_kept() -> Iterator[None]:
    """
    Switch off LLVM's scheduler of machine instructions.

    The option is global in llvmlite's copy of LLVM. The lock keeps other threads and other users
    of llvmlite, as Numba, from compiling meanwhile. Afterwards the option has LLVM's default,
    whatever it was before. Without the lock, or with an LLVM that may not have the option, the
    scheduler stays on: code is then slower by some percent and computes the same bits.
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


def _load_entry(code: bytes, functions: Sequence[str], target: Target) -> Any:
    """Return the library of a cache entry, or None if it holds no object for the target."""
    # LLVM also links objects for other processors.
    if code.startswith(_object_header(target)):
        with suppress(RuntimeError):
            return _load(code, functions, target)
    disk.LOG.info('an object in the cache cannot be linked here: it is compiled again')
    return None


@cache
def _object_header(target: Target) -> bytes:
    """Return the first bytes of every object for a target: its format and processor."""
    empty = bytes(_machine(target, USUAL).emit_object(llvm.parse_assembly('')))
    return empty[: HEADER_BYTES.get(empty[:4], COFF_MACHINE)]


def _load(code: bytes, functions: Sequence[str], target: Target) -> Any:
    """Return the library of an object file, which owns its code and finds its functions."""
    # JITLink places code, constants and table next to each other. Each module has its own linker,
    # because a common one would not free everything.
    linker = llvm.create_lljit_compiler(_machine(target, USUAL), use_jit_link=True)
    builder = llvm.JITLibraryBuilder().add_object_img(code).add_current_process()
    for name, address in _symbols.items():
        builder.import_symbol(name, address)
    for name in functions:
        builder.export_symbol(name)
    return builder.link(linker, 'kernel')


# A process forks between two calls of LLVM, never during one.
hold_at_fork(LLVM_LOCK or nullcontext())
