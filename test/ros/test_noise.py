# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Counter-based noise: published vectors, accuracy of the inverse, statistics, independence."""

from __future__ import annotations

from collections.abc import Callable

from bridge import (
    NOISE_BLOCK,
    NOISE_LARGEST_SEED,
    NoiseChannel,
    inverse_normal,
    noise_normal,
    noise_uniform,
    philox,
)
import mpmath
import numpy as np
import pytest


# From the file kat_vectors of Random123, the authors' own implementation.
@pytest.mark.parametrize(
    ('counter', 'key', 'words'),
    [
        (
            [0, 0, 0, 0],
            [0, 0],
            [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8],
        ),
        (
            [0xFFFFFFFF] * 4,
            [0xFFFFFFFF] * 2,
            [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD],
        ),
        (
            [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344],
            [0xA4093822, 0x299F31D0],
            [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1],
        ),
    ],
)
def test_the_bits_equal_the_published_vectors(counter, key, words) -> None:
    got = philox(np.array(counter, np.uint64)[:, None], key[0] | key[1] << 32)
    assert got[:, 0].tolist() == words


def test_the_inverse_of_the_normal_distribution_is_right_to_1e_14() -> None:
    near = np.linspace(0.0004, 0.9996, 301)
    tails = 2.0 ** -np.arange(4, 54)
    p = np.concatenate([near, tails, 1.0 - tails])
    with mpmath.workdps(40):
        exact = [mpmath.sqrt(2) * mpmath.erfinv(2 * mpmath.mpf(float(x)) - 1) for x in p]
        pairs = zip(inverse_normal(p).tolist(), exact, strict=True)
        errors = [abs(x / y - 1) for x, y in pairs if y]
    assert max(errors) < 1e-14


def test_normal_deviates_end_at_8_2_standard_deviations() -> None:
    ends = inverse_normal(np.array([2.0**-53, 1.0 - 2.0**-53]))
    assert ends[0] == -ends[1]
    assert 8.2 < ends[1] < 8.21


def samples(draw, seed: int, channel: NoiseChannel, cycles: int = 4000, n: int = 6) -> np.ndarray:
    return np.array([draw(seed, channel, cycle, n) for cycle in range(cycles)])


# The deviates are fixed numbers: a p-value is one too, and a limit of 1e-3 is no game of chance.
def test_deviates_have_their_distributions() -> None:
    # Not in every worker that collects this file: it takes 0.7 s.
    from scipy import stats

    for seed in (0, 1, NOISE_LARGEST_SEED):
        flat = samples(noise_uniform, seed, NoiseChannel.POSITION).ravel()
        assert ((flat >= 0) & (flat < 1)).all()
        assert stats.kstest(flat, 'uniform').pvalue > 1e-3
        bell = samples(noise_normal, seed, NoiseChannel.VELOCITY).ravel()
        assert stats.kstest(bell, 'norm').pvalue > 1e-3
        share = (np.abs(bell) > 3).mean()
        assert abs(share - 2 * stats.norm.sf(3)) < 5 * np.sqrt(0.0027 / bell.size)


@pytest.mark.parametrize(
    'draw',
    [
        lambda: samples(noise_normal, 7, NoiseChannel.VELOCITY),
        lambda: samples(noise_normal, 8, NoiseChannel.POSITION),
        lambda: samples(noise_normal, 7 + 2**32, NoiseChannel.POSITION),
        lambda: samples(noise_normal, 7, NoiseChannel.POSITION, 4001)[1:],
        lambda: samples(noise_normal, 7, NoiseChannel.POSITION, n=7)[:, 1:],
    ],
    ids=['channel', 'seed', 'high-word-of-seed', 'cycle', 'element'],
)
def test_neighbours_are_independent(draw: Callable[[], np.ndarray]) -> None:
    one, other = samples(noise_normal, 7, NoiseChannel.POSITION), draw()
    for a, b in ((one, other), (one**2, other**2)):
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4 / np.sqrt(one.size)


def test_an_element_depends_neither_on_the_number_of_elements_nor_on_earlier_requests() -> None:
    cycle = 5 * NOISE_BLOCK + 3
    far = 2**40 + 1
    assert noise_normal(3, NoiseChannel.EFFORT, cycle, 7)[:4].tolist() == (
        noise_normal(3, NoiseChannel.EFFORT, cycle, 4).tolist()
    )
    assert set(noise_normal(3, NoiseChannel.EFFORT, far, 4)).isdisjoint(
        noise_normal(3, NoiseChannel.EFFORT, 1, 4)
    )
    with pytest.raises(ValueError, match='read-only'):
        noise_normal(3, NoiseChannel.EFFORT, cycle, 4)[0] = 0.0
