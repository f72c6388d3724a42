// Copyright 2026 The pfd_ros authors
// SPDX-License-Identifier: Apache-2.0
//
// The loop of a controller around another library's simulation of an arm of N joints, as
// contenders/control_loop.py compiles it.

#include <math.h>

// Advances q and qd by `periods` of `substeps` steps of h seconds, with the torques taus.
typedef void (*Advance)(void *arm, long long periods, long long substeps, double h, double *q,
                        double *qd, const double *taus, double *states);

// In each period: torques of a PD law about a reference, then the steps of the arm. `law` is kp
// and kd; `reference` has in each row torques fed forward, positions and velocities.
void control(Advance advance, void *arm, long long periods, long long substeps, double h,
             const double *law, const double *reference, double *q, double *qd) {
    double tau[N];
    for (long long k = 0; k < periods; k++) {
        const double *row = reference + k * 3 * N;
        for (int i = 0; i < N; i++)
            tau[i] = row[i] + law[i] * (row[N + i] - q[i]) + law[N + i] * (row[2 * N + i] - qd[i]);
        advance(arm, 1, substeps, h, q, qd, tau, 0);
    }
}

// MuJoCo: mj_step on a model and its data, with the torques bounded by `limit`.
struct Mujoco {
    void (*step)(const void *model, void *data);
    const void *model;
    void *data;
    double *qpos, *qvel, *applied;
    const double *limit;
};

void mujoco(void *arm, long long periods, long long substeps, double h, double *q, double *qd,
            const double *taus, double *states) {
    (void)periods, (void)h, (void)states;
    struct Mujoco *m = arm;
    for (int i = 0; i < N; i++) m->applied[i] = fmax(-m->limit[i], fmin(m->limit[i], taus[i]));
    for (long long s = 0; s < substeps; s++) m->step(m->model, m->data);
    for (int i = 0; i < N; i++) q[i] = m->qpos[i], qd[i] = m->qvel[i];
}

#ifdef SZ_ARG
// CasADi: the classical Runge-Kutta method around `arm`, CasADi's function of one state. `effects`
// is limit, damping, friction and width; friction is -F v / width, bounded by F.
static void at(const double *effects, const double *q, const double *qd, const double *taus,
               double *qdd) {
    const double *limit = effects, *damping = effects + N;
    const double *friction = effects + 2 * N, *width = effects + 3 * N;
    double tau[N], *res[SZ_RES], w[SZ_W];
    casadi_int iw[SZ_IW];
    for (int i = 0; i < N; i++) {
        double slip = fmax(-1.0, fmin(1.0, qd[i] / width[i]));
        tau[i] = fmax(-limit[i], fmin(limit[i], taus[i])) - damping[i] * qd[i] - friction[i] * slip;
    }
    const double *arg[SZ_ARG] = {q, qd, tau};
    res[0] = qdd;
    arm(arg, res, iw, w, 0);
}

void casadi(void *effects, long long periods, long long substeps, double h, double *q, double *qd,
            const double *taus, double *states) {
    double a1[N], a2[N], a3[N], a4[N], x[N], v2[N], v3[N], v4[N];
    const double *e = effects;
    (void)periods, (void)states;
    for (long long s = 0; s < substeps; s++) {
        at(e, q, qd, taus, a1);
        for (int i = 0; i < N; i++) v2[i] = qd[i] + h / 2 * a1[i], x[i] = q[i] + h / 2 * qd[i];
        at(e, x, v2, taus, a2);
        for (int i = 0; i < N; i++) v3[i] = qd[i] + h / 2 * a2[i], x[i] = q[i] + h / 2 * v2[i];
        at(e, x, v3, taus, a3);
        for (int i = 0; i < N; i++) v4[i] = qd[i] + h * a3[i], x[i] = q[i] + h * v3[i];
        at(e, x, v4, taus, a4);
        for (int i = 0; i < N; i++) {
            q[i] += h / 6 * (qd[i] + 2 * v2[i] + 2 * v3[i] + v4[i]);
            qd[i] += h / 6 * (a1[i] + 2 * a2[i] + 2 * a3[i] + a4[i]);
        }
    }
}
#endif
