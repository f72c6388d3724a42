# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Routes of the methods on n lanes, with one lane per link, as closed forms by hand.

A recurrence on vectors takes a shift of each component in each of L = ceil(log2 n) levels; a row
of pairs i < j takes a broadcast of each component of link i. Packed routes are stored in docs and
compared in test_paper_networks.
"""

from __future__ import annotations

from bridge import FORWARD_METHODS, PCRBM_ARRAY_SECTION, resolve_plant
from closed_forms import EVERY_SIZE, chain, levels, routes_by_section
import pytest

Routes = dict[str, int]


def pose_and_bias(n: int) -> Routes:
    """Return 9 elements a level of R; z_(i-1); five sums of vectors, and w_(i-1)."""
    many = n > 1
    return {
        'orientation': 9 * levels(n),
        'link vectors': 3 * many,
        'omega': 15 * levels(n) + 3 * many,
    }


def composite_bodies(n: int) -> Routes:
    """Return M, c with its coefficients, E; M_(j+1), c_(j+1); p*_i and z_i for the pairs."""
    L, many = levels(n), n > 1
    return {
        'equation (15)': L,
        'equations (16), (17)': many,
        'equation (18)': (4 * L - 1) * many,
        'equation (19)': 3 * many,
        'equation (20)': 6 * L,
        'moments of the row sweep': 3 * (n - 1),
        'elements of H': 3 * (n - 1),
    }


def solve(n: int) -> Routes:
    """Return l_ij for j < i < n - 1 and 1/d_j; n - 1 elements each way, n - 1 diagonals."""
    return {
        'factorisation': (n - 1) * (n - 2) // 2 + n - 1,
        'column sweeps': 3 * (n - 1),
    }


def about_the_base(n: int) -> Routes:
    """Return o_i and o_(i-1); mass, first moment and inertia; pairs at distances around."""
    L = levels(n)
    # Two 6-vectors for each distance; a pair farther apart than n/2 comes out on the other lane.
    far = sum(n - d for d in range(1, n) if 2 * d > n)
    return {
        'base origin': 3 * L + 3 * (n > 1),
        'composite bodies': 10 * L,
        'elements of H': 12 * (n // 2) + far,
    }


def streams(n: int) -> Routes:
    """Return the elements of H and y on their way to the array; h_11 and y_1 are on lane 0."""
    return {f'streams of the {PCRBM_ARRAY_SECTION}': n * (n + 1) // 2 + n - 2}


EXPECTED = {
    'pcrbm': lambda n: pose_and_bias(n) | composite_bodies(n) | solve(n),
    'pcrbm_array': lambda n: pose_and_bias(n) | composite_bodies(n) | streams(n),
    'pcrbm_base_origin': lambda n: pose_and_bias(n) | about_the_base(n) | solve(n),
    # Four sums of vectors, two inner products, of which each result is broadcast.
    'pcgm': lambda n: (
        pose_and_bias(n)
        | {
            'first inner product': levels(n),
            'step 7': 12 * levels(n),
            'step 8': levels(n) + (n > 1),
            'step 12': levels(n),
            'steps 14, 15': n > 1,
        }
    ),
}


@pytest.mark.sweep
@pytest.mark.parametrize('n', EVERY_SIZE)
@pytest.mark.parametrize('method', EXPECTED)
def test_routes_with_one_lane_per_link_have_their_closed_forms(method: str, n: int) -> None:
    found = routes_by_section(FORWARD_METHODS[method](resolve_plant(chain(n)), 'unpacked'))
    assert found == {section: count for section, count in EXPECTED[method](n).items() if count}
