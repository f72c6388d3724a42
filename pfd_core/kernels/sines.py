# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Sine and cosine in the machine's operations, and angles beyond their range.

    sincos          sine and cosine of |x| up to WRAP_LIMIT, in `+ - *` and floats: on NumPy
                    arrays, and on lane values that are being recorded
    expand_sines    a program with every sine and cosine written out
    wrap_angle      LLVM IR that brings a larger angle into [-pi, pi]

Every operation is rounded correctly and the order is fixed, so the bits are the same on every
machine, in the emulator and in a kernel. Counts of operations (machine.operations) have sine and
cosine as one step each.

Method: x = k pi/2 + r with the nearest integer k, where pi/2 is cut into parts so short that k
times a part is exact (Cody and Waite, Software Manual for the Elementary Functions, 1980), a
minimax polynomial for each of sin r and cos r, and the sum of angles r and k pi/2, in which one
product is zero and the other exact.

Error, for |x| <= WRAP_LIMIT, in units in the last place of the result: at most 1.36 in float64
(the worst case of every rounding, added up) and 1.40 in float32 (the largest of all arguments);
1.1 where the result comes from the sine's polynomial. A kernel fuses multiplications and
additions: then it is at most 1.42 in float32 (of all arguments) and has been seen up to 1.34 in
float64 (4e7 arguments). `sincos` guarantees 1.5 for all of these. No result exceeds one in
magnitude, and the sine of -0 is -0.

The polynomials are minimax, fitted in 50 digits by Remez exchange on 1500 points, in the relative
error of sin r and cos r for |r| up to 0.785398164 in float64 and 0.7916 in float32. Coefficients
were rounded one at a time, lowest power first, and the rest was fitted again. Parts of pi/2 are
multiples of 2^-36 and 2^-73 in float64, of 2^-7, 2^-19, 2^-24, 2^-33 and 2^-41 in float32, each
rounded down, the last of these to the nearest, so that k times a part is exact for every k up to
65535; what is left is a further part.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter
from typing import Any

from pfd_core.machine.program import Program, renamed
from pfd_core.machine.recorder import Lanes, Recorder

# Largest angle in magnitude for which `sincos` keeps its error bound [rad].
WRAP_LIMIT = 1e5


@dataclass(frozen=True)
class _Constants:
    """
    The constants of one number format.

    pi/2 is the sum of all parts: `exact + middle + (last,)`. k times a part is exact but for the
    last; x minus the exact ones is exact as well, however much cancels. Between `unit` and twice
    `unit` neighbouring numbers are one apart: adding and subtracting 1.5 `unit` rounds to an
    integer, 3 `unit` to a multiple of two.
    """

    unit: float
    two_over_pi: float
    exact: tuple[float, ...]
    middle: tuple[float, ...]
    last: float
    sine: tuple[float, ...]  # sin r = r - r h (s0 + s1 h + ...), h = r r / 2
    cosine: tuple[float, ...]  # cos r = 1 - h + h h (c0 + c1 h + ...)


_CONSTANTS = {
    'float64': _Constants(
        unit=2.0**52,
        two_over_pi=0.6366197723675814,
        exact=(1.5707963267923333,),
        middle=(2.5633441515839558e-12,),
        last=1.0562999066987428e-23,
        sine=(
            0.3333333333333326,
            -0.03333333333328736,
            0.0015873015863486822,
            -4.409170166162355e-05,
            8.016235004629642e-07,
            -1.017307731952648e-08,
        ),
        cosine=(
            0.16666666666666638,
            -0.011111111111098674,
            0.0003968253966240333,
            -8.818340549453201e-06,
            1.336045145381423e-07,
            -1.4539199081353166e-09,
        ),
    ),
    'float32': _Constants(
        unit=2.0**23,
        two_over_pi=0.6366197466850281,
        exact=(1.5703125, 0.0004825592041015625, 1.2516975402832031e-06),
        middle=(1.5832483768463135e-08, 6.093614501878619e-11),
        last=-1.6513995574653217e-13,
        sine=(0.3333330750465393, -0.033328425139188766, 0.0015606306260451674),
        cosine=(0.16666658222675323, -0.01110984105616808, 0.00039089188794605434),
    ),
}


def sincos(x: Any, dtype: str) -> tuple[Any, Any]:
    """
    Return sine and cosine of an angle [rad], within 1.5 units in the last place.

    The angle is an array or a lane value of the format `dtype`, at most WRAP_LIMIT in magnitude:
    above it the result loses its accuracy. NaN and infinity give NaN.
    """
    c = _CONSTANTS[dtype]
    k = _round(x * c.two_over_pi, 1.5 * c.unit)
    r, excess = _reduce(x, k, c)
    h = r * 0.5 * r
    # r carries a rounding, which sine passes on and cosine dampens: only sine corrects it.
    sine = r - (r * h * _polynomial(c.sine, h) + excess)
    cosine = 1.0 - (h - h * (h * _polynomial(c.cosine, h)))

    # Cosine and minus sine of k quarter turns, each 1, 0 or -1: how far k + 1 and k are from the
    # nearest multiple of two, which halfway between two of them is the multiple of four.
    turned = k + 1.0
    along = turned - _round(turned, 3.0 * c.unit)
    down = _round(k, 3.0 * c.unit) - k
    return sine * along - cosine * down, cosine * along + sine * down


def _round(x: Any, magic: float) -> Any:
    """Round to a multiple of the spacing that numbers near `magic` have."""
    return (x + magic) - magic


def _reduce(x: Any, k: Any, c: _Constants) -> tuple[Any, Any]:
    """Return r and a correction `excess` with r - excess = x - k pi/2 to twice the digits."""
    for part in c.exact:
        x = x - k * part
    first, *others = c.middle
    r, excess = _difference(x, k * first)
    for part in others:
        r, excess = _difference(r, k * part + excess)
    return r, excess + k * c.last


def _difference(a: Any, b: Any) -> tuple[Any, Any]:
    """
    Return d = a - b, rounded, and d - (a - b).

    The latter is exact where a is not smaller than b and also where d is exact. In this order of
    operations it is +0 for a = -0, b = +0, and -0 - 0 keeps the sign of a zero.
    """
    d = a - b
    return d, d - a + b


def _polynomial(coefficients: tuple[float, ...], h: Any) -> Any:
    """Evaluate a polynomial, lowest power first in `coefficients`, after Horner."""
    value: Any = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        value = value * h + coefficient
    return value


def expand_sines(program: Program, dtype: str) -> Program:
    """Return the program with every sine and cosine written out in the other operations."""
    recorder = Recorder(program.lanes)
    names: list[int] = []  # register of the old program -> register of the new one
    pairs: dict[int, tuple[Lanes, Lanes]] = {}
    for section, instructions in groupby(program.instructions, attrgetter('section')):
        with recorder.section(section):
            for op, args, data, active, _ in instructions:
                if op in ('sin', 'cos'):
                    (angle,) = args
                    if angle not in pairs:
                        on = program.instructions[angle].active
                        pairs[angle] = sincos(Lanes(recorder, (names[angle],), on), dtype)
                    register = pairs[angle][op == 'cos'].registers[0]
                else:
                    register = recorder.write(op, tuple([names[a] for a in args]), data, active)
                names.append(register)
    return renamed(program, recorder.program().instructions, names)


# Bits after the binary point: of 1 / 2 pi, of the fraction of a turn, and of 2 pi.
TABLE_BITS = 1280  # at least 971, the largest e, and 256
TURN_BITS = 256
TWO_PI_BITS = 125  # 2 pi is then a 128-bit integer
# Bits of a word of memory.
WORD = 64
# Binary digits of a significand, and the offset of the exponent when it is an integer.
DIGITS = 53
OFFSET = 1075
# 1 / 2 pi, cut off, and 2 pi, rounded to nearest.
TURNS = int(
    '28be60db9391054a7f09d5f47d4d377036d8a5664f10e4107f9458eaf7aef1586dc91b8e909374b8'
    '01924bba827464873f877ac72c4a69cfba208d7d4baed1213a671c09ad17df904e64758e60d4ce7d'
    '272117e2ef7e4a0ec7fe25fff7816603fbcbc462d6829b47db4d9fb3c9f2c26dd3d18fd9a797fa8b'
    '5d49eeb1faf97c5ecf41ce7de294a4ba9afed7ec47e357421580cc11bf1edaeafc33ef0826bd0d87',
    16,
)
TWO_PI = 0xC90FDAA22168C234C4C6628B80DC1CD1


def wrap_angle(limit: float = WRAP_LIMIT) -> str:
    """
    Return the LLVM IR of `double @wrap_angle(double)`: an angle modulo 2 pi, in [-pi, pi].

    Angles up to `limit` in magnitude stay as they are. Larger ones are rare, and reduced with
    exact integers instead of floating point (Payne and Hanek, Radian reduction for trigonometric
    functions, SIGNUM Newsletter 18, 1983). With x = m 2^e, multiples of one in x / 2 pi drop out
    before anything is multiplied, so 256 bits of 2^e / 2 pi below the binary point are enough for
    every e; m times them, modulo one, is the fraction of a turn that remains.

    Error: the result is the remainder rounded to nearest, except where the remainder lies within
    2^-70 of its last place of the middle between two neighbours; that is, at most 0.5 + 2^-70
    units in the last place. The fraction of a turn is off by less than 2^-203; that is little
    because no double in reach comes closer to a multiple of 2 pi than 2^-62 turns, which the
    tests prove.

    The IR declares intrinsics; a module must not declare them again. It loads the words of
    1 / 2 pi that it needs: a shift of all bits takes three times as long to compile.
    """
    words = [TURNS >> WORD * k & (1 << WORD) - 1 for k in range(TABLE_BITS // WORD + 1)]
    loaded = [
        f"""
  %index{k} = add i64 %first, {k}
  %place{k} = getelementptr i64, ptr @turns, i64 %index{k}
  %word{k} = load i64, ptr %place{k}"""
        for k in range(TURN_BITS // WORD + 1)
    ]
    joined = [
        f"""
  %part{k} = call i64 @llvm.fshr.i64(i64 %word{k + 1}, i64 %word{k}, i64 %down)
  %wide{k} = zext i64 %part{k} to i{TURN_BITS}
  %moved{k} = shl i{TURN_BITS} %wide{k}, {WORD * k}
  %window{k + 1} = or i{TURN_BITS} %window{k}, %moved{k}"""
        for k in range(TURN_BITS // WORD)
    ]
    return f"""
declare i64 @llvm.fshr.i64(i64, i64, i64)
declare i256 @llvm.ctlz.i256(i256, i1 immarg)

@turns = internal constant [{len(words)} x i64] [{', '.join(f'i64 {word}' for word in words)}]

define internal double @wrap_angle(double %x) noinline cold {{
entry:
  %bits = bitcast double %x to i64
  %magnitude = and i64 %bits, {2**63 - 1}
  %size = bitcast i64 %magnitude to double
  %near = fcmp ole double %size, {limit:e}
  br i1 %near, label %identity, label %far
identity:
  ret double %x
far:
  %biased = lshr i64 %magnitude, {DIGITS - 1}
  %nonfinite = icmp eq i64 %biased, 2047
  br i1 %nonfinite, label %invalid, label %reduce
invalid:
  ret double 0x7FF8000000000000
reduce:
  ; |x| = m 2^(biased - {OFFSET}); the fraction of a turn is m times a window of 1 / 2 pi
  %fraction = and i64 %bits, {2**52 - 1}
  %m64 = or i64 %fraction, {2**52}
  %m = zext i64 %m64 to i{TURN_BITS}
  %down = sub i64 {TABLE_BITS - TURN_BITS + OFFSET}, %biased
  %first = udiv i64 %down, {WORD}
  %window0 = add i{TURN_BITS} 0, 0{''.join(loaded)}{''.join(joined)}
  %signed = mul i256 %window{TURN_BITS // WORD}, %m
  %negative = icmp slt i256 %signed, 0
  %opposite = sub i256 0, %signed
  %turns = select i1 %negative, i256 %opposite, i256 %signed
  ; the upper half of the fraction, without leading zeros, times 2 pi
  %zeros = call i256 @llvm.ctlz.i256(i256 %turns, i1 false)
  %normal = shl i256 %turns, %zeros
  %upper = lshr i256 %normal, 128
  %product = mul i256 %upper, {TWO_PI}
  %more = call i256 @llvm.ctlz.i256(i256 %product, i1 false)
  %full = shl i256 %product, %more
  ; rounded to nearest, and scaled by the exponent
  %leading = lshr i256 %full, {255 - DIGITS}
  %leading64 = trunc i256 %leading to i64
  %above = add i64 %leading64, 1
  %rounded = lshr i64 %above, 1
  %number = uitofp i64 %rounded to double
  %lost = add i256 %zeros, %more
  %lost64 = trunc i256 %lost to i64
  %exponent = sub i64 {1023 + (256 - DIGITS) - TWO_PI_BITS - 128}, %lost64
  %scale64 = shl i64 %exponent, {DIGITS - 1}
  %scale = bitcast i64 %scale64 to double
  %angle = fmul double %number, %scale
  %angle64 = bitcast double %angle to i64
  %sign = and i64 %bits, {-(2**63)}
  %flip = select i1 %negative, i64 {-(2**63)}, i64 0
  %signs = xor i64 %sign, %flip
  %result64 = xor i64 %angle64, %signs
  %result = bitcast i64 %result64 to double
  ret double %result
}}
"""
