# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
States at which forward dynamics is hard to compute, as one table (CASES).

A case is a robot in a scene and seeded states, with the cause of its difficulty and bounds of the
relative error of qdd. The bounds hold for the kernel of method 'auto' with one step of refinement.
They were set before this table was measured, except for static_hold; a case that misses its
bound is reported as missed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from pfd_core.report.hard_case_problems import (
    Array,
    Problem,
    arm,
    chain,
    collinear,
    far,
    heavy_tip,
    mixed,
    one_link,
    payload,
    problem,
    rotors,
    scaled,
    static_hold,
    tiny_tip,
    wrist,
)

ROUNDING = {'float64': 2.0**-53, 'float32': 2.0**-24}


@dataclass(frozen=True)
class Bound:
    """
    A bound of the relative error: value, times u, or times u and kappa_s of the state.

    Attributes
    ----------
    value : float
        The factor.
    unit : {'', 'u', 'kappa_s u'}
        u is the unit of rounding of the number format, ROUNDING.

    """

    value: float
    unit: str = ''

    def at(self, dtype: str, kappa_s: Array) -> Array:
        """Return the bound for states whose structured condition numbers are kappa_s, (S,)."""
        scale = ROUNDING[dtype] if self.unit else 1.0
        return self.value * scale * (kappa_s if 'kappa_s' in self.unit else np.ones_like(kappa_s))

    def __str__(self) -> str:
        return f'{self.value:g} {self.unit}'.strip()


@dataclass(frozen=True)
class Case:
    """
    A named problem.

    Attributes
    ----------
    name, cause : str
        Name, and the reason why the problem is hard.
    make : callable
        Makes the problem.
    float64, float32 : Bound
        Bounds of the kernel's error with one step of refinement.
    plain : Bound, optional
        Bound in float64 without refinement.
    wide : bool
        Whether the float32 bound was set for residuals in float64, which no kernel here has.
    fast : bool
        Whether the case takes less than about a second.

    """

    name: str
    cause: str
    make: Callable[[], Problem]
    float64: Bound
    float32: Bound | None = None
    plain: Bound | None = None
    wide: bool = False
    fast: bool = False

    def bound(self, dtype: str, refine: int) -> Bound | None:
        """Return the bound of the kernel in a number format, where there is one."""
        if refine == 0:
            return self.plain if dtype == 'float64' else None
        return self.float64 if dtype == 'float64' else self.float32


# The rule for every case: at most 100 kappa_s u after a step of refinement.
LAW = Bound(100, 'kappa_s u')
TIGHT, SINGLE = Bound(20, 'u'), Bound(1e-6)
STRETCHED = 'H is nearly singular: its condition grows with n^4 along a stretched chain'
HEAVY = 'small inertias are differences of large ones that the heavy last link leaves'
COAXIAL = 'two joints on one axis are distinguished only by the inertia between them'
LIGHT_TIP = 'sums about the base swamp the inertia of the last link'
WRIST = 'two axes of the wrist nearly coincide: singular kinematics'
UNITS = 'a hidden absolute tolerance, or an exponent out of range'
MASSLESS = 'a link without inertia: a zero pivot in a careless elimination'

CASES: Sequence[Case] = (
    Case('stretched_12', STRETCHED, lambda: problem(chain(12, 'y'), q=0.0), LAW),
    Case('stretched_200', STRETCHED, lambda: problem(chain(200, 'y'), q=0.0), TIGHT, Bound(1e-5)),
    Case(
        'random_200',
        'rounding piles up over many links',
        lambda: problem(chain(200, 'yz')),
        Bound(1e-14),
        Bound(1e-5),
    ),
    Case('near_stretched_6', STRETCHED, lambda: problem(chain(6, 'y'), q=1e-3), LAW, fast=True),
    Case('near_stretched_40', STRETCHED, lambda: problem(chain(40, 'y'), q=1e-3), LAW),
    Case(
        'folded_12',
        'every link lies on the one before',
        lambda: problem(chain(12, 'y'), q=np.array([0.0] + [np.pi] * 11)),
        LAW,
    ),
    Case('heavy_tip_1e8_n6', HEAVY, lambda: heavy_tip(6, 'yz'), LAW, Bound(1e-5), wide=True),
    Case(
        'heavy_tip_1e8_planar_n6',
        HEAVY,
        lambda: heavy_tip(6, 'y'),
        LAW,
        Bound(1e-5),
        wide=True,
        fast=True,
    ),
    Case('heavy_tip_1e8_n12', HEAVY, lambda: heavy_tip(12, 'yz'), LAW, Bound(1e-5), wide=True),
    Case(
        'heavy_tip_1e8_planar_n12',
        HEAVY,
        lambda: heavy_tip(12, 'y'),
        LAW,
        Bound(1e-5),
        wide=True,
    ),
    Case(
        'heavy_base_1e8',
        'the first link is a hundred million times heavier than the rest',
        lambda: one_link(0, 1e8),
        LAW,
    ),
    Case('payload_1e6', HEAVY, payload, Bound(1e-14), Bound(1e-3), wide=True, fast=True),
    Case('feather_tip_1e-8', LIGHT_TIP, lambda: one_link(5, 1e-8), LAW),
    Case('massless_mid_1e-12', MASSLESS, lambda: one_link(2, 1e-12), LAW),
    Case('massless_mid_0', MASSLESS, lambda: one_link(2, 0.0), TIGHT, SINGLE, fast=True),
    Case('collinear_axes_1e-4', COAXIAL, lambda: collinear(1e-4), LAW),
    Case('collinear_axes_1e-12', COAXIAL, lambda: collinear(1e-12), Bound(1e-14), fast=True),
    Case('collinear_axes_1e-8_payload_1e4', COAXIAL, lambda: collinear(1e-8, 1e4), Bound(1e-14)),
    Case('tiny_tip_1e-6', LIGHT_TIP, lambda: problem(tiny_tip(1e-6)), TIGHT, SINGLE),
    Case('tiny_tip_1e-12', LIGHT_TIP, lambda: problem(tiny_tip(1e-12)), TIGHT, SINGLE),
    Case('tiny_tip_1e-18', LIGHT_TIP, lambda: problem(tiny_tip(1e-18)), TIGHT, SINGLE, fast=True),
    Case('far_base_16m', 'sums about a distant origin', lambda: far(16.0), LAW),
    Case('far_base_1km', 'sums about a distant origin', lambda: far(1000.0), LAW, fast=True),
    Case('wrist_q5_0', WRIST, lambda: wrist(0.0), TIGHT, SINGLE, fast=True),
    Case('wrist_q5_1e-8', WRIST, lambda: wrist(1e-8), TIGHT, SINGLE),
    Case('wrist_q5_1e-4', WRIST, lambda: wrist(1e-4), TIGHT, SINGLE),
    Case(
        'fast_qd_1e6',
        'velocity products of 1e12 compared with torques of 1',
        lambda: problem(chain(6, 'yz'), qd=1e6),
        LAW,
        Bound(1e-5),
        fast=True,
    ),
    Case(
        'large_angle_1e6',
        'sine and cosine of angles far from zero',
        lambda: problem(chain(6, 'yz'), q=1e6),
        LAW,
    ),
    Case('micro_arm_1um', UNITS, lambda: scaled(2.0**-20, 2.0**-20), LAW),
    Case('giant_arm_1km', UNITS, lambda: scaled(2.0**10, 2.0**30), LAW),
    Case('mixed_scales', 'links of 1 m and 1 kg between links of 1 mm and 1 mg', mixed, LAW),
    Case('geared_rotors_1e6', 'rotor inertias a million times those of the links', rotors, LAW),
    Case(
        'static_hold',
        'torques and gravity cancel: nothing is left to be relative to',
        static_hold,
        # In place of 20 u, which is less than the 80 u of the case's own numbers: over 60 states
        # of it every method is above 20 u in a third of them.
        Bound(1, 'kappa_s u'),
        Bound(1e-5),
    ),
    Case(
        'puma560_as_published',
        'link 3 breaks the triangle rule, link 1 has no mass',
        lambda: arm('puma560', 10),
        TIGHT,
        SINGLE,
    ),
    *(
        Case(
            f'ordinary_{name}',
            'none: an ordinary arm at any state',
            partial(arm, name, 100),
            Bound(2e-15),
            SINGLE,
            Bound(2e-15),
        )
        for name in ('puma560', 'ur5', 'panda', 'planar2')
    ),
)

# Cases of other lists that are not in the report, by the reason.
LATER = {
    'inputs, repeated runs and iterations of pcgm (see the tests)': (
        'bad_inputs',
        'determinism',
        'cg_baseline',
    ),
    'arms not included in config/robots': ('seven of the eleven ordinary arms',),
}
