// Copyright 2026 The pfd_ros authors
// SPDX-License-Identifier: Apache-2.0
//
// The loop of a controller around another library's simulation of an arm of N joints
// (peers/control_loop.py).

#include <math.h>

// Advances q and qd by `periods` of `substeps` steps of h seconds, with the torques taus.
typedef void (*Advance)(void *arm, long long periods, long long substeps, double h, double *q,
                        double *qd, const double *taus);

// In each period: torques of a PD law about a reference, then the steps of the arm. `law` is kp
// and kd; `reference` has in each row torques fed forward, positions and velocities.
void control(Advance advance, void *arm, long long periods, long long substeps, double h,
             const double *law, const double *reference, double *q, double *qd) {
    double tau[N];
    for (long long k = 0; k < periods; k++) {
        const double *row = reference + k * 3 * N;
        for (int i = 0; i < N; i++)
            tau[i] = row[i] + law[i] * (row[N + i] - q[i]) + law[N + i] * (row[2 * N + i] - qd[i]);
        advance(arm, 1, substeps, h, q, qd, tau);
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
            const double *taus) {
    (void)periods, (void)h;
    struct Mujoco *m = arm;
    for (int i = 0; i < N; i++) m->applied[i] = fmax(-m->limit[i], fmin(m->limit[i], taus[i]));
    for (long long s = 0; s < substeps; s++) m->step(m->model, m->data);
    for (int i = 0; i < N; i++) q[i] = m->qpos[i], qd[i] = m->qvel[i];
}
