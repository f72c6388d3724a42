// Copyright 2026 The pfd_ros authors
// SPDX-License-Identifier: Apache-2.0
//
// Loops around `arm`, CasADi's function of one state, whose code precedes this file
// (peers/casadi.py). N joints; the function has ARGUMENTS arguments and ELEMENTS results.

void batch(long long count, const double **in, double *out) {
    const double *arg[SZ_ARG];
    double *res[SZ_RES], w[SZ_W];
    casadi_int iw[SZ_IW];
    for (long long k = 0; k < count; k++) {
        for (int i = 0; i < ARGUMENTS; i++) arg[i] = in[i] + k * N;
        res[0] = out + k * ELEMENTS;
        arm(arg, res, iw, w, 0);
    }
}

#ifdef INTEGRATORS
// Accelerations under the torques tau. `effects` is null, or limit, damping, friction and width:
// tau is bounded by limit, and friction is -F v / width, bounded by F.
static void at(const double *effects, const double *q, const double *qd, const double *tau,
               double *qdd) {
    double applied[N];
    const double *in[] = {q, qd, tau};
    if (effects) {
        const double *limit = effects, *damping = effects + N;
        const double *friction = effects + 2 * N, *width = effects + 3 * N;
        for (int i = 0; i < N; i++) {
            double slip = fmax(-1.0, fmin(1.0, qd[i] / width[i]));
            applied[i] =
                fmax(-limit[i], fmin(limit[i], tau[i])) - damping[i] * qd[i] - friction[i] * slip;
        }
        in[2] = applied;
    }
    batch(1, in, qdd);
}

// Simulations: `substeps` steps of h seconds in each period, whose torques are a row of taus.

// The classical Runge-Kutta method.
void rollout(const double *effects, long long periods, long long substeps, double h, double *q,
             double *qd, const double *taus) {
    double a1[N], a2[N], a3[N], a4[N], x[N], v2[N], v3[N], v4[N];
    for (long long k = 0; k < periods * substeps; k++) {
        const double *tau = taus + k / substeps * N;
        at(effects, q, qd, tau, a1);
        for (int i = 0; i < N; i++) v2[i] = qd[i] + h / 2 * a1[i], x[i] = q[i] + h / 2 * qd[i];
        at(effects, x, v2, tau, a2);
        for (int i = 0; i < N; i++) v3[i] = qd[i] + h / 2 * a2[i], x[i] = q[i] + h / 2 * v2[i];
        at(effects, x, v3, tau, a3);
        for (int i = 0; i < N; i++) v4[i] = qd[i] + h * a3[i], x[i] = q[i] + h * v3[i];
        at(effects, x, v4, tau, a4);
        for (int i = 0; i < N; i++) {
            q[i] += h / 6 * (qd[i] + 2 * v2[i] + 2 * v3[i] + v4[i]);
            qd[i] += h / 6 * (a1[i] + 2 * a2[i] + 2 * a3[i] + a4[i]);
        }
    }
}

// Velocity Verlet with a predicted velocity; a step begins with the acceleration at which the step
// before it ended, if the torques are the same.
void verlet(const double *effects, long long periods, long long substeps, double h, double *q,
            double *qd, const double *taus) {
    double a[N], end[N], v[N];
    for (long long k = 0; k < periods; k++) {
        const double *tau = taus + k * N;
        at(effects, q, qd, tau, a);
        for (long long s = 0; s < substeps; s++) {
            for (int i = 0; i < N; i++) q[i] += h * (qd[i] + h / 2 * a[i]), v[i] = qd[i] + h * a[i];
            at(effects, q, v, tau, end);
            for (int i = 0; i < N; i++) qd[i] += h / 2 * (a[i] + end[i]), a[i] = end[i];
        }
    }
}

// The semi-implicit Euler method.
void euler(const double *effects, long long periods, long long substeps, double h, double *q,
           double *qd, const double *taus) {
    double a[N];
    for (long long k = 0; k < periods * substeps; k++) {
        at(effects, q, qd, taus + k / substeps * N, a);
        for (int i = 0; i < N; i++) qd[i] += h * a[i], q[i] += h * qd[i];
    }
}
#endif
