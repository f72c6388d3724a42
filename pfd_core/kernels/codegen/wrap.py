# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
LLVM IR of @wrap_angle: an angle modulo 2 pi, in [-pi, pi], if its magnitude exceeds a limit.

`sincos` in pfd_core.kernels.passes.sincos takes |x| up to WRAP_LIMIT; such angles stay as they
are. A linearised step wraps smaller angles, too (codegen.linear_step). Larger ones are rare, and
reduced with exact integers instead of floating point (Payne and Hanek, Radian reduction for
trigonometric functions, SIGNUM Newsletter 18, 1983). With x = m 2^e, multiples of one in
x / 2 pi drop out before anything is multiplied, so 256 bits of 2^e / 2 pi below the binary point
are enough for every e; m times them, modulo one, is the fraction of a turn that remains.

Error: the result is the remainder rounded to nearest, except where the remainder lies within
2^-70 of its last place of the middle between two neighbours; that is, at most 0.5 + 2^-70 units
in the last place. The fraction of a turn is off by less than 2^-203; that is little because no
double in reach comes closer to a multiple of 2 pi than 2^-62 turns, which the tests prove.
"""

from __future__ import annotations

from pfd_core.kernels.passes.sincos import WRAP_LIMIT

# Bits after the binary point: of 1 / 2 pi, of the fraction of a turn, and of 2 pi.
_TABLE_BITS = 1280  # at least 971, the largest e, and 256
_TURN_BITS = 256
_TWO_PI_BITS = 125  # 2 pi is then a 128-bit integer
# Binary digits of a significand, and the offset of the exponent when it is an integer.
_DIGITS = 53
_OFFSET = 1075


def _pi(bits: int) -> int:
    """Return pi 2^bits, at most 1 off, after Machin: pi = 16 atan 1/5 - 4 atan 1/239."""
    guard = 32
    total = 0
    for factor, d in ((16, 5), (-4, 239)):
        power = (factor << (bits + guard)) // d
        n = 1
        while power not in (0, -1):
            total += power // n if n % 4 == 1 else -(power // n)
            power //= d * d
            n += 2
    return total >> guard


_TURNS = (1 << (2 * _TABLE_BITS + 64)) // _pi(_TABLE_BITS + 65)  # 2^1280 / 2 pi
_TWO_PI = (_pi(_TWO_PI_BITS + 32) >> 30) + 1 >> 1  # to nearest


# This IR declares @llvm.ctlz.i256; a module must not declare it again.
_WRAP_ANGLE_IR = f"""
declare i256 @llvm.ctlz.i256(i256, i1 immarg)

define internal double @wrap_angle(double %x) noinline cold {{
entry:
  %bits = bitcast double %x to i64
  %magnitude = and i64 %bits, {2**63 - 1}
  %size = bitcast i64 %magnitude to double
  %near = fcmp ole double %size, LIMIT
  br i1 %near, label %identity, label %far
identity:
  ret double %x
far:
  %biased = lshr i64 %magnitude, {_DIGITS - 1}
  %nonfinite = icmp eq i64 %biased, 2047
  br i1 %nonfinite, label %invalid, label %reduce
invalid:
  ret double 0x7FF8000000000000
reduce:
  ; |x| = m 2^(biased - {_OFFSET}); the fraction of a turn is m times a window of 1 / 2 pi
  %fraction = and i64 %bits, {2**52 - 1}
  %m64 = or i64 %fraction, {2**52}
  %m = zext i64 %m64 to i{_TURN_BITS}
  %down64 = sub i64 {_TABLE_BITS - _TURN_BITS + _OFFSET}, %biased
  %down = zext i64 %down64 to i{_TABLE_BITS}
  %shifted = lshr i{_TABLE_BITS} {_TURNS}, %down
  %window = trunc i{_TABLE_BITS} %shifted to i{_TURN_BITS}
  %signed = mul i256 %window, %m
  %negative = icmp slt i256 %signed, 0
  %opposite = sub i256 0, %signed
  %turns = select i1 %negative, i256 %opposite, i256 %signed
  ; the upper half of the fraction, without leading zeros, times 2 pi
  %zeros = call i256 @llvm.ctlz.i256(i256 %turns, i1 false)
  %normal = shl i256 %turns, %zeros
  %upper = lshr i256 %normal, 128
  %product = mul i256 %upper, {_TWO_PI}
  %more = call i256 @llvm.ctlz.i256(i256 %product, i1 false)
  %full = shl i256 %product, %more
  ; rounded to nearest, and scaled by the exponent
  %leading = lshr i256 %full, {255 - _DIGITS}
  %leading64 = trunc i256 %leading to i64
  %above = add i64 %leading64, 1
  %rounded = lshr i64 %above, 1
  %number = uitofp i64 %rounded to double
  %lost = add i256 %zeros, %more
  %lost64 = trunc i256 %lost to i64
  %exponent = sub i64 {1023 + (256 - _DIGITS) - _TWO_PI_BITS - 128}, %lost64
  %scale64 = shl i64 %exponent, {_DIGITS - 1}
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


def wrap_angle(limit: float = WRAP_LIMIT) -> str:
    """Return `double @wrap_angle(double)`, which returns angles up to a limit as they are."""
    return _WRAP_ANGLE_IR.replace('LIMIT', f'{limit:e}')
