# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The processor to compile for: this machine's, or PFD_TARGET_CPU.

The environment variable takes a name that LLVM knows (x86-64-v2, skylake-avx512, znver4, ...) and
is read at each compilation. What a processor has comes from LLVM's own tables. The code runs in
this process, so a processor with instructions that this machine lacks is refused.

Results have the same bits on every processor. Where it has no fused multiply-add, LLVM calls
`fma` of the C library, which C99 requires to round once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
import os
import re

import llvmlite.binding as llvm

VARIABLE = 'PFD_TARGET_CPU'
# Features whose instructions LLVM writes only for intrinsics that this package does not use: a
# machine without them runs the code all the same. Virtual machines hide many of them.
UNUSED = re.compile(
    'amx-.*|cldemote|clflushopt|clwb|clzero|enqcmd|fsgsbase|hreset|invpcid|kl|lwp|movdir64b|'
    'movdiri|movrs|mwaitx|pconfig|pku|prefetchi|prfchw|ptwrite|rdpid|rdpru|rdrnd|rdseed|rtm|'
    'serialize|sgx|shstk|tsxldtrk|uintr|usermsr|waitpkg|wbnoinvd|widekl|xsave.*'
)
# One function that needs a feature, and one for the processor, which calls it.
QUESTION = """
attributes #{n} = {{ "target-cpu"="{least}" "target-features"="{base}+{feature}" }}
define internal void @needs{n}(ptr %p) #{n} {{
  store volatile i32 {n}, ptr %p
  ret void
}}
define void @asks{n}(ptr %p) "target-cpu"="{cpu}" "target-features"="{base}" {{
  call void @needs{n}(ptr %p)
  ret void
}}
"""


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


def current() -> Target:
    """
    Return the processor to compile for.

    Raises
    ------
    ValueError
        If PFD_TARGET_CPU names a processor that LLVM does not know, or whose code cannot run here.

    """
    cpu = os.environ.get(VARIABLE, '').strip()
    if not cpu:
        return host()
    missing = missing_features(cpu)
    if missing:
        raise ValueError(
            f'{VARIABLE} must name a processor whose code runs on this machine '
            f'({host().cpu}), got {cpu!r}, which needs {", ".join(missing)}'
        )
    return named(cpu)


@cache
def host() -> Target:
    """Return the processor of this machine."""
    return Target(
        llvm.get_process_triple(), llvm.get_host_cpu_name(), _flat(_features_of_machine())
    )


@cache
def named(cpu: str) -> Target:
    """
    Return a processor of this machine's architecture, by its name.

    Raises
    ------
    ValueError
        If LLVM does not know the processor.

    """
    # LLVM compares the features of two functions before it puts one into the other.
    triple, names = llvm.get_process_triple(), sorted(_features_of_machine())
    found: list[str] = []
    if re.fullmatch(r'[\w.-]+', cpu):
        least, base = ('x86-64', '+64bit,') if triple.startswith('x86_64') else ('generic', '')
        ir = ''.join(
            QUESTION.format(n=n, least=least, base=base, cpu=cpu, feature=feature)
            for n, feature in enumerate(names)
        )
        left = set(re.findall(r'@needs(\d+)\(', _inlined(ir, triple)))
        found = [feature for n, feature in enumerate(names) if str(n) not in left]
    if not found:
        raise ValueError(
            f'{VARIABLE} must name a processor that LLVM '
            f'{".".join(map(str, llvm.llvm_version_info))} knows for {triple}, such as '
            f'{llvm.get_host_cpu_name()}, got {cpu!r}'
        )
    return Target(triple, cpu, _flat(dict.fromkeys(found, True)))


def missing_features(cpu: str) -> list[str]:
    """Return the features that code for a processor may use and this machine lacks."""
    here, there = _features_of_machine(), named(cpu).features.split(',')
    needed = [feature[1:] for feature in there if feature.startswith('+')]
    return [name for name in needed if not here[name] and not UNUSED.fullmatch(name)]


def _features_of_machine() -> dict[str, bool]:
    """Return the features that LLVM knows, and whether this machine has them."""
    try:
        return dict(llvm.get_host_cpu_features())
    except RuntimeError:  # LLVM cannot query every processor; the name is enough then
        return {}


def _flat(features: dict[str, bool]) -> str:
    """Return features as LLVM reads them; registers of 512 bits are used where there are any."""
    if features.get('avx512f'):
        features = features | {'prefer-256-bit': False}
    return ','.join(f'{"+" if on else "-"}{name}' for name, on in sorted(features.items()))


def _inlined(ir: str, triple: str) -> str:
    """Return a module after LLVM put functions into each other."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_triple(triple).create_target_machine()
    module = llvm.parse_assembly(ir)
    module.triple = triple
    options = llvm.create_pipeline_tuning_options(speed_level=1)
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    return str(module)
