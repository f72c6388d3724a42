# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Compiling: LLVM IR text becomes the address of native code for this processor.

The code generator is told nothing that lets it change a result: no fast-math flags, no
contraction of a multiplication and an addition into one. What one processor computes, another
computes bit for bit.

Objects are kept on disk (pfd_core.kernels.runtime.disk_cache) under everything that decides them.
A fresh one and a kept one are brought into the process in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
import os
import re
import time
from typing import Any

import llvmlite
import llvmlite.binding as llvm

from pfd_core.kernels.runtime import disk_cache as disk

# A function that a module shows to the outside.
SHOWN = re.compile(r'^define (?!internal )[^@\n]*@([\w.]+)\(', re.MULTILINE)
# Bytes of an object before the first that is its own, by the four with which the format begins:
# ELF (up to e_machine) and Mach-O (up to filetype). COFF begins with the machine at once.
FORMATS = {b'\x7fELF': 20, b'\xcf\xfa\xed\xfe': 16}
COFF_MACHINE = 2
# What modules may name that lies in this process: addresses by name.
_symbols: dict[str, int] = {}


@dataclass(frozen=True)
class Outline:
    """
    What has to be known of a module of LLVM IR to use its object.

    Attributes
    ----------
    digest : str
        SHA-256 of the text.
    functions : sequence of str
        The functions that it shows to the outside.

    """

    digest: str
    functions: Sequence[str]


@dataclass(frozen=True)
class Native:
    """
    Native code of one module.

    Attributes
    ----------
    seconds : float
        Time it took to compile it, or to find it on disk.
    library : object
        What holds the code, which lives as long as this.

    """

    seconds: float
    library: Any

    def address(self, name: str) -> int:
        """Return the address of a function."""
        return int(self.library[name])


@dataclass(frozen=True)
class Target:
    """
    A processor to compile for.

    Attributes
    ----------
    triple : str
        Architecture, vendor and system, as LLVM writes them.
    cpu, features : str
        Name of the processor and its extensions, as LLVM writes them.

    """

    triple: str
    cpu: str = ''
    features: str = ''

    @property
    def vector_bits(self) -> int:
        """Bits in one vector register: AVX-512, AVX, or NEON and SSE2."""
        on = set(self.features.split(','))
        return 512 if '+avx512f' in on else 256 if '+avx' in on else 128


@dataclass(frozen=True)
class Optimisation:
    """
    How hard LLVM tries; the bits of a result do not depend on it.

    Every choice is a field, because the fields are part of an object's name on disk. The
    default cleans up around the straight-line code, which is already as short as it gets.

    Attributes
    ----------
    passes, code : int
        Levels of the passes over the text and of the code generator.
    slp_vectorization, loop_vectorization : bool
        Whether scalars and loops are turned into vectors.
    relocation, code_model : str
        How code refers to its constants, and to what is outside.

    """

    passes: int = 1
    code: int = 2
    slp_vectorization: bool = False
    loop_vectorization: bool = False
    relocation: str = 'pic'
    code_model: str = 'small'


USUAL = Optimisation()


def outline(ir: str) -> Outline:
    """Return what has to be known of a module."""
    return Outline(disk.digest(ir), SHOWN.findall(ir))


def compile_ir(ir: str, optimisation: Optimisation = USUAL) -> Native:
    """Return the native code of a module of LLVM IR, from disk if it was compiled before."""
    return compile_outlined(outline(ir), lambda: ir, optimisation)


def compile_outlined(
    known: Outline, text: Callable[[], str], optimisation: Optimisation = USUAL
) -> Native:
    """Return the same of a module whose text is written only if its object is not on disk."""
    start = time.perf_counter()
    target = host()
    name = object_key(known.digest, target, optimisation)
    kept = disk.read(name)
    library = None if kept is None else _load_kept(kept, known.functions, target)
    if library is None:
        code = emit(text(), target, optimisation)
        disk.write(name, code)
        library = _load(code, known.functions, target)
    return Native(time.perf_counter() - start, library)


def object_key(digest: str, target: Target, optimisation: Optimisation) -> str:
    """Return the name of an object on disk: a digest of all that decides its bytes."""
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
        The processor, which need not be the one at hand.
    optimisation : Optimisation
        How hard to try.

    Raises
    ------
    RuntimeError
        If the text is no sound module, or this LLVM cannot compile for the target.

    """
    machine = _machine(target, optimisation)
    module = llvm.parse_assembly(ir)
    module.triple = target.triple
    module.data_layout = str(machine.target_data)
    module.verify()
    _optimise(module, machine, optimisation)
    return bytes(machine.emit_object(module))


def add_symbol(name: str, address: int) -> None:
    """Let modules refer to something of this process by name."""
    _symbols[name] = address


def simd_width(dtype: str, target: Target | None = None) -> int:
    """Return how many numbers one vector register of a processor, by default this one, holds."""
    bits = (host() if target is None else target).vector_bits
    return bits // (64 if dtype == 'float64' else 32)


@cache
def host() -> Target:
    """Return the processor at hand."""
    features = _features()
    if features.get('avx512f'):
        features['prefer-256-bit'] = False
    flat = ','.join(f'{"+" if on else "-"}{name}' for name, on in sorted(features.items()))
    return Target(llvm.get_process_triple(), llvm.get_host_cpu_name(), flat)


def _features() -> dict[str, bool]:
    try:
        return dict(llvm.get_host_cpu_features())
    except RuntimeError:  # LLVM cannot ask every processor; then its name has to do
        return {}


@cache
def _initialise(triple: str) -> None:
    """Make LLVM know how to compile for a target."""
    if triple == llvm.get_process_triple():
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
    else:
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()


def _machine(target: Target, optimisation: Optimisation) -> Any:
    _initialise(target.triple)
    # Constants lie beside the code, so that an instruction reaches them by itself; only what is
    # the process's own is reached through a table.
    return llvm.Target.from_triple(target.triple).create_target_machine(
        cpu=target.cpu,
        features=target.features,
        opt=optimisation.code,
        reloc=optimisation.relocation,
        codemodel=optimisation.code_model,
    )


def _optimise(module: Any, machine: Any, optimisation: Optimisation) -> None:
    options = llvm.create_pipeline_tuning_options(speed_level=optimisation.passes)
    options.slp_vectorization = optimisation.slp_vectorization
    options.loop_vectorization = optimisation.loop_vectorization
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)


def _load_kept(code: bytes, functions: Sequence[str], target: Target) -> Any:
    """Return the same as `_load` of an object from disk, or None if it is none for the target."""
    # LLVM links what is for another processor, too.
    if code.startswith(_beginning(target)):
        with suppress(RuntimeError):
            return _load(code, functions, target)
    disk.LOG.info('an object in the cache cannot be linked here: it is compiled again')
    return None


@cache
def _beginning(target: Target) -> bytes:
    """Return the bytes with which every object for a target begins: its format and processor."""
    empty = bytes(_machine(target, USUAL).emit_object(llvm.parse_assembly('')))
    return empty[: FORMATS.get(empty[:4], COFF_MACHINE)]


def _load(code: bytes, functions: Sequence[str], target: Target) -> Any:
    """Return a library that holds the code of an object file and knows where its functions are."""
    # JITLink sees to it that code, constants and table come to lie next to each other. A linker
    # of its own for each module, because one for all would not give back everything.
    linker = llvm.create_lljit_compiler(_machine(target, USUAL), use_jit_link=True)
    builder = llvm.JITLibraryBuilder().add_object_img(code).add_current_process()
    for name, address in _symbols.items():
        builder.import_symbol(name, address)
    for name in functions:
        builder.export_symbol(name)
    return builder.link(linker, 'kernel')


# A process is copied between two calls of LLVM, never during one: a child has no thread that
# would give llvmlite's lock back.
_lock = getattr(llvm.ffi.lib, '_lock', None)
if _lock is not None and hasattr(os, 'register_at_fork'):
    os.register_at_fork(
        before=_lock.__enter__, after_in_parent=_lock.__exit__, after_in_child=_lock.__exit__
    )
