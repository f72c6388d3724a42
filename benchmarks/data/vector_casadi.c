// Copyright 2026 The pfd_ros authors
// SPDX-License-Identifier: Apache-2.0
//
// Eight states at a time: CasADi's C of one state with `double` replaced by a vector type of the
// compiler (peers/casadi.py), which inserts its statements as the body of `arm` below.

#include <stdint.h>
#include <string.h>

enum { LANES = 8 };
typedef double Vector __attribute__((vector_size(64)));
typedef double Unaligned __attribute__((vector_size(64), aligned(8)));
typedef int64_t Bits __attribute__((vector_size(64)));
typedef int32_t Integers __attribute__((vector_size(32)));
#define INLINE static inline __attribute__((always_inline))

// x = k pi/2 + r by two multiply-adds, and Cephes' polynomials for |r| <= pi/4. Truncation after
// adding 2^16 + 0.5 gives 2^16 more than the nearest integer k, which for |x| <= 1e5 is positive:
// `k >> 63` is zero, and keeps a compiler from merging the two parts of pi/2. Without fused
// multiply-adds the product of k and pi/2 is rounded, and no digit of a large angle is left.
#if !defined(__FMA__) && !defined(__ARM_FEATURE_FMA)
#error sine and cosine of vectors need a processor with fused multiply-add
#endif
INLINE void sine_cosine(Vector x, Vector *sine, Vector *cosine) {
    Integers nearest = __builtin_convertvector(x * 0.63661977236758134 + 65536.5, Integers);
    Vector whole = __builtin_convertvector(nearest - 65536, Vector);
    Bits k = __builtin_convertvector(nearest, Bits);
    Vector r = x - whole * 1.5707963267948966;
    r = (Vector)((Bits)r ^ (k >> 63)) - whole * 6.123233995736766e-17;
    Vector z = r * r;
    Vector p = z * 1.58962301576546568060e-10 - 2.50507477628578072866e-8;
    p = p * z + 2.75573136213857245213e-6;
    p = p * z - 1.98412698295895385996e-4;
    p = p * z + 8.33333333332211858878e-3;
    p = p * z - 1.66666666666666307295e-1;
    Vector s = p * z * r + r;
    p = z * -1.13585365213876817300e-11 + 2.08757008419747316778e-9;
    p = p * z - 2.75573141792967388112e-7;
    p = p * z + 2.48015872888517045348e-5;
    p = p * z - 1.38888888888730564116e-3;
    p = p * z + 4.16666666666665929218e-2;
    Vector c = p * z * z + (1.0 - 0.5 * z);
    Bits odd = -(k & 1), a = (Bits)s, b = (Bits)c;
    *sine = (Vector)(((a & ~odd) | (b & odd)) ^ ((k & 2) << 62));
    *cosine = (Vector)(((b & ~odd) | (a & odd)) ^ (((k + 1) & 2) << 62));
}

INLINE Vector vector_sin(Vector x) {
    Vector s, c;
    sine_cosine(x, &s, &c);
    return s;
}

INLINE Vector vector_cos(Vector x) {
    Vector s, c;
    sine_cosine(x, &s, &c);
    return c;
}

INLINE Vector vector_sq(Vector x) { return x * x; }

// The states lie in columns, of which the first numbers are `stride` apart.
INLINE void arm(long long stride, const double *q, const double *qd, const double *tau,
                double *qdd) {
    @BODY@
}

// Up to eight states in rows or columns: through columns of eight on the stack.
INLINE void some(int rows, long long stride, int states, const double *q, const double *qd,
                 const double *tau, double *qdd) {
    double x[4 * N * LANES] __attribute__((aligned(64)));
    const double *in[] = {q, qd, tau};
    for (int j = 0; j < 3; j++)
        for (int i = 0; i < N; i++)
            for (int k = 0; k < LANES; k++) {
                int from = k < states ? k : 0;
                x[(j * N + i) * LANES + k] = in[j][rows ? from * N + i : i * stride + from];
            }
    arm(LANES, x, x + N * LANES, x + 2 * N * LANES, x + 3 * N * LANES);
    for (int i = 0; i < N; i++)
        for (int k = 0; k < states; k++)
            qdd[rows ? k * N + i : i * stride + k] = x[(3 * N + i) * LANES + k];
}

// States in columns, NumPy's Fortran order.
void columns(long long count, const double *q, const double *qd, const double *tau, double *qdd) {
    long long k = 0;
    for (; k + LANES <= count; k += LANES) arm(count, q + k, qd + k, tau + k, qdd + k);
    if (k < count) some(0, count, count - k, q + k, qd + k, tau + k, qdd + k);
}

// States in rows, NumPy's C order, transposed on the way.
void rows(long long count, const double *q, const double *qd, const double *tau, double *qdd) {
    long long k = 0;
    for (; k + LANES <= count; k += LANES)
        some(1, 0, LANES, q + k * N, qd + k * N, tau + k * N, qdd + k * N);
    if (k < count) some(1, 0, count - k, q + k * N, qd + k * N, tau + k * N, qdd + k * N);
}

// Sine and cosine of a multiple of eight angles, to measure their error.
void sines(long long count, const double *x, double *sine, double *cosine) {
    for (long long k = 0; k < count; k += LANES) {
        Vector s, c;
        sine_cosine(*(const Unaligned *)(x + k), &s, &c);
        *(Unaligned *)(sine + k) = s;
        *(Unaligned *)(cosine + k) = c;
    }
}
