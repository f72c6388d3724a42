# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers, integers and times from outside: taken right, or refused by name."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from decimal import Decimal
from fractions import Fraction
from typing import Any
import warnings

import numpy as np
import pytest

import pfd_core as pfd
from pfd_core.model.checked_numbers import integer, real_array
from pfd_core.model.error_text import quote

ROBOT = pfd.load_robot('planar2')
TWO = [0.5, -0.25]


class Degrees(np.ndarray):
    """An array with units, as unit packages have them."""

    unit = 'deg'


class NoText:
    """An object that cannot even be shown."""

    def __repr__(self) -> str:
        raise RuntimeError('no')


ENDLESS: list[Any] = []
ENDLESS.append(ENDLESS)

STRANGE = {
    'complex': ([1j, 0], 'complex128'),
    'complex array': (np.array([1, 2], complex), 'complex128'),
    'bools': ([True, False], 'got bool'),
    'array of bool': (np.array([True, False]), 'got bool'),
    'a bool among numbers': ([[1.0, True]], 'got bool'),
    'digits as text': (['1', '2'], '<U1'),
    'text': ('push', "got 'push'"),
    'bytes': (b'12', "got b'12'"),
    'nothing': (None, 'got None'),
    'no number among them': ([1.0, None], r'got \[1.0, None\]'),
    'a mapping': ({'q': 1}, "got {'q': 1}"),
    'a generator': ((x for x in TWO), 'generator object'),
    'a huge integer': ([10**400, 1], 'must fit float'),
    'too huge to be shown': ([10**5000, 1], 'must fit float'),
    'masked': (np.ma.masked_array(TWO, [True, False]), 'masked array'),
    'masked nowhere': (np.ma.masked_array(TWO), 'masked array'),
    'rows that are masked': ([np.ma.masked_array(TWO, [True, False])] * 2, 'masked array'),
    'masked elements': ([np.ma.masked, 1.0], 'masked array'),
    'units': (np.array(TWO).view(Degrees), "units .'deg'"),
    'rows with units': ([np.array(TWO).view(Degrees)] * 2, "units .'deg'"),
    'dates': (np.array(['2026-01-01', '2026-01-02'], 'M8[s]'), r'datetime64\[s\]'),
    'durations': (np.array([1, 2], 'm8[s]'), r'timedelta64\[s\]'),
    'date objects': ([datetime(2026, 1, 1)] * 2, 'datetime'),
    'records': (np.zeros(2, [('a', float)]), "'a'"),
    'decimals': ([Decimal('0.1'), Decimal('0.2')], 'Decimal'),
    'ragged rows': ([[1.0], [2.0, 3.0]], 'inhomogeneous'),
    'endless lists': (ENDLESS, 'q must be an array'),
    'objects without text': ([NoText(), 1], 'NoText'),
}
RIGHT = {
    'integers': [1, -2],
    'unsigned': np.array([1, 2], np.uint8),
    'half precision': np.array(TWO, np.float16),
    'extended precision': np.array(TWO, np.longdouble),
    'other byte order': np.array(TWO, '>f8'),
    'fractions': [Fraction(1, 2), Fraction(-1, 4)],
    'large integers': [10**20, 1],
    'a tuple of scalars': (np.float32(0.5), np.int64(3)),
}


@pytest.mark.parametrize('case', STRANGE)
@pytest.mark.parametrize('dtype', ['float64', 'float32'])
def test_values_other_than_real_numbers_are_refused_by_name(case: str, dtype: str) -> None:
    value, message = STRANGE[case]
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        with pytest.raises(ValueError, match=message) as caught:
            real_array('q', value, dtype)
    assert str(caught.value).startswith('q must ')
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize('case', RIGHT)
@pytest.mark.parametrize('dtype', ['float64', 'float32'])
def test_real_numbers_of_any_kind_are_taken_as_numpy_would(case: str, dtype: str) -> None:
    found = real_array('q', RIGHT[case], dtype)
    assert type(found) is np.ndarray
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, [np.dtype(dtype).type(x) for x in RIGHT[case]])


def test_numbers_beyond_the_range_of_a_format_are_refused_and_infinity_is_not() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        with pytest.raises(ValueError, match=r'q must fit float32, got \[1e\+300, 1.0\]'):
            real_array('q', [1e300, 1.0], 'float32')
        assert np.isinf(real_array('q', [np.inf, 1.0], 'float32', finite=False)[0])


def test_arrays_of_the_format_are_not_copied() -> None:
    array = np.zeros((3, 2))
    assert real_array('q', array, 'float64') is array


def test_a_long_value_is_cut_in_a_message() -> None:
    for value in ([0.0] * 1_000_000, 'x' * 1_000_000, np.zeros(1_000_000, str), {1: 'y' * 10**6}):
        assert len(quote(value)) < 200
    with pytest.raises(ValueError, match='taus must be an array of numbers') as caught:
        pfd.Simulator(ROBOT).rollout([[0.0, 'x' * 10_000]] * 100)
    assert len(str(caught.value)) < 300


CALLS: dict[str, Callable[[Any], Any]] = {
    'emulate': lambda x: pfd.emulate(ROBOT, x, TWO, TWO),
    'emulate with digits': lambda x: pfd.emulate(ROBOT, TWO, TWO, x, digits=30),
    'kernel': lambda x: pfd.compile_kernel(ROBOT)(TWO, x, TWO),
    'forward_dynamics': lambda x: pfd.forward_dynamics(ROBOT, TWO, TWO, x, method='auto'),
    'inverse_dynamics': lambda x: pfd.inverse_dynamics(ROBOT, TWO, TWO, x),
    'reset': lambda x: pfd.Simulator(ROBOT).reset(q=x),
    'step': lambda x: pfd.Simulator(ROBOT).step(x),
    'rollout': lambda x: pfd.Simulator(ROBOT).rollout(x),
    'ensemble reset': lambda x: pfd.Ensemble(ROBOT, 2).reset(qd=x),
    'ensemble rollout': lambda x: pfd.Ensemble(ROBOT, 2).rollout(x),
    'feedback': lambda x: pfd.Ensemble(ROBOT, 2).rollout(
        steps=2, feedback=pfd.Feedback([1, 1], [1, 1], x)
    ),
}


@pytest.mark.sweep
@pytest.mark.parametrize('call', CALLS)
@pytest.mark.parametrize(
    'case', ['complex', 'digits as text', 'a huge integer', 'masked', 'units', 'dates', 'records']
)
def test_every_call_refuses_what_is_no_number(call: str, case: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        with pytest.raises(ValueError, match=r'must (be an array of numbers|fit float64), got'):
            CALLS[call](STRANGE[case][0])


INTEGERS: dict[str, Callable[[Any], Any]] = {
    'substeps': lambda x: pfd.Simulator(ROBOT, substeps=x).step(TWO),
    'refine': lambda x: pfd.Simulator(ROBOT, refine=x).step(TWO),
    'size': lambda x: pfd.Ensemble(ROBOT, x).rollout(steps=1),
    'steps': lambda x: pfd.Ensemble(ROBOT, 2).rollout(steps=x),
    'every': lambda x: pfd.Ensemble(ROBOT, 2).rollout(steps=2, every=x),
}


@pytest.mark.parametrize('name', INTEGERS)
def test_numpys_integers_are_integers(name: str) -> None:
    for kind in (np.int64, np.uint8, np.array):
        INTEGERS[name](kind(1))


@pytest.mark.parametrize('name', INTEGERS)
@pytest.mark.parametrize('value', [True, np.True_, 1.0, '1', -1, np.int64(-1), -(10**400), [1]])
def test_what_is_no_integer_is_refused_by_name(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=f'{name} must be an integer of at least [01], got'):
        INTEGERS[name](value)


def test_an_integer_above_its_bound_is_refused_with_both_bounds() -> None:
    with pytest.raises(ValueError, match='size must be an integer from 1 to 9, got 10'):
        integer('size', 10, 1, 9)
    with pytest.raises(ValueError, match=f'size must be an integer from 1 to {2**63 - 1}, got'):
        integer('size', 2**63, 1)


def test_an_integer_is_returned_as_pythons() -> None:
    assert type(integer('size', np.int32(3), 1)) is int


@pytest.mark.parametrize('value', ['1', None, 1j, True, [0.1, 0.2], 10**400, np.nan, -1.0])
def test_a_step_size_that_is_no_duration_is_refused(value: object) -> None:
    with pytest.raises(
        ValueError,
        match=r'step_size must (be above zero seconds|be a number|be finite|fit float64), got',
    ):
        pfd.Simulator(ROBOT, step_size=value)  # type: ignore[arg-type]


@pytest.mark.parametrize('value', ['1', 1j, [0.0], 10**400, np.inf])
def test_an_invalid_time_is_refused(value: object) -> None:
    with pytest.raises(ValueError, match=r'time must (be finite|be a number|fit float64), got'):
        pfd.Simulator(ROBOT).reset(time=value)  # type: ignore[arg-type]


@pytest.mark.parametrize('value', [np.float32(0.001), np.array(0.001), Fraction(1, 1000)])
def test_scalars_of_any_kind_are_durations(value: object) -> None:
    sim = pfd.Simulator(ROBOT, step_size=value)  # type: ignore[arg-type]
    assert sim.step_size == float(value)  # type: ignore[arg-type]


@pytest.mark.parametrize('size', [10**12, 10**30])
def test_an_ensemble_that_no_memory_holds_is_refused(size: int) -> None:
    with pytest.raises(ValueError, match=f'size={size} arms take .* GB, but this machine has'):
        pfd.Ensemble(ROBOT, size)
