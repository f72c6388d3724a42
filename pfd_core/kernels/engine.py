# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Compiling: LLVM IR text becomes the address of native code for this processor.

The code generator is told nothing that lets it change a result: no fast-math flags, no
contraction of a multiplication and an addition into one. What one processor computes, another
computes bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
import time
from typing import Any

import llvmlite.binding as llvm


@dataclass(frozen=True)
class Native:
    """
    Native code of one module.

    Attributes
    ----------
    ir : str
        The text it was made of.
    seconds : float
        Time the compiler took.

    """

    ir: str
    seconds: float
    engine: Any

    def address(self, name: str) -> int:
        """Return the address of a function."""
        address = int(self.engine.get_function_address(name))
        if not address:
            raise KeyError(f'the module has no function {name}')
        return address


def compile_ir(ir: str) -> Native:
    """Return the native code of a module of LLVM IR."""
    start = time.perf_counter()
    machine = _machine()
    module = llvm.parse_assembly(ir)
    module.verify()
    _optimise(module, machine)
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    return Native(ir, time.perf_counter() - start, engine)


def add_symbol(name: str, address: int) -> None:
    """Let modules refer to something of this process by name."""
    llvm.add_symbol(name, address)


def simd_width(dtype: str) -> int:
    """Return how many numbers one vector register of this processor holds."""
    features = _features()
    bits = 512 if features.get('avx512f') else 256 if features.get('avx') else 128
    return bits // (64 if dtype == 'float64' else 32)


@cache
def _features() -> dict[str, bool]:
    return dict(llvm.get_host_cpu_features())


@cache
def _initialise() -> None:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()


def _machine() -> Any:
    _initialise()
    target = llvm.Target.from_default_triple()
    features = llvm.get_host_cpu_features()
    features['prefer-256-bit'] = False
    return target.create_target_machine(
        cpu=llvm.get_host_cpu_name(), features=features.flatten(), opt=2
    )


def _optimise(module: Any, machine: Any) -> None:
    """Clean up around the straight-line code, which is already as short as it gets."""
    options = llvm.create_pipeline_tuning_options(speed_level=1)
    options.slp_vectorization = False
    options.loop_vectorization = False
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
