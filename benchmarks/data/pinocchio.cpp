// Copyright 2026 The pfd_ros authors
// SPDX-License-Identifier: Apache-2.0
//
// Pinocchio's C++ with the loops around it (peers/pinocchio.py). All matrices are row by
// row; arrays of states are (count, n) row by row.

#include <memory>
#include <string>

#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/algorithm/cholesky.hpp>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/rnea.hpp>

namespace pin = pinocchio;
using Eigen::VectorXd;
using Input = Eigen::Map<const VectorXd>;
using Output = Eigen::Map<VectorXd>;
using Vector3 = Eigen::Map<const Eigen::Vector3d>;
using Matrix3 = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>;

// The kinds of joints of a model are a parameter of Pinocchio's classes. With these two instead of
// all 25 there is less to compile, and a UR5 takes the same time within 6 %.
template <typename Scalar_, int Options_>
struct Kinds {
    using Scalar = Scalar_;
    static constexpr int Options = Options_;
    using JointModelRZ = pin::JointModelRevoluteTpl<Scalar, Options, 2>;
    using JointModelPZ = pin::JointModelPrismaticTpl<Scalar, Options, 2>;
    using JointDataRZ = pin::JointDataRevoluteTpl<Scalar, Options, 2>;
    using JointDataPZ = pin::JointDataPrismaticTpl<Scalar, Options, 2>;
    using JointModelVariant = boost::variant<JointModelRZ, JointModelPZ>;
    using JointDataVariant = boost::variant<JointDataRZ, JointDataPZ>;
};
using Model = pin::ModelTpl<double, 0, Kinds>;
using Data = pin::DataTpl<double, 0, Kinds>;

struct Arm {
    Model model;
    std::unique_ptr<Data> data;
    bool effects = false;
    VectorXd limit, damping, friction, width;
    // What the loops work on: copies of a state, so that each algorithm is compiled once.
    VectorXd q, qd, tau, x, v2, v3, v4, a1, a2, a3, torque;
};

namespace {

VectorXd copied(const double *values, int n) {
    return values ? VectorXd(Input(values, n)) : VectorXd(VectorXd::Zero(n));
}

const VectorXd &aba_of(Arm &arm, const VectorXd &q, const VectorXd &qd, const VectorXd &tau,
                       pin::Convention convention = pin::Convention::LOCAL) {
    return pin::aba(arm.model, *arm.data, q, qd, tau, convention);
}

// tau within its limits, less the torques of friction.
const VectorXd &applied(Arm &arm, const VectorXd &qd, const VectorXd &tau) {
    if (!arm.effects) return tau;
    arm.torque = tau.cwiseMax(-arm.limit).cwiseMin(arm.limit) - arm.damping.cwiseProduct(qd) -
                 arm.friction.cwiseProduct(
                     qd.cwiseQuotient(arm.width).cwiseMax(-1.0).cwiseMin(1.0));
    return arm.torque;
}

const VectorXd &acceleration(Arm &arm, const VectorXd &q, const VectorXd &qd) {
    return aba_of(arm, q, qd, applied(arm, qd, arm.tau));
}

template <class Evaluate>
void each(Arm &arm, long long count, const double *q, const double *qd, const double *tau,
          double *qdd, Evaluate evaluate) {
    const int n = arm.model.nv;
    for (long long k = 0; k < count; k++) {
        arm.q = Input(q + k * n, n), arm.qd = Input(qd + k * n, n);
        arm.tau = Input(tau + k * n, n);
        Output(qdd + k * n, n) = evaluate();
    }
}

}  // namespace

extern "C" {

// An arm of n joints about or along z. The placement of a joint's frame is in the frame before, the
// inertia of its link in the joint's frame. `rotors` may be null. `torques` is null, or limit,
// damping, friction and width, n numbers each.
Arm *make(int n, const int *prismatic, const double *rotations, const double *translations,
          const double *masses, const double *centers, const double *inertias,
          const double *gravity, const double *rotors, const double *torques) {
    Arm *arm = new Arm();
    for (int i = 0; i < n; i++) {
        const pin::SE3 frame(Matrix3(rotations + 9 * i), Vector3(translations + 3 * i));
        const pin::Inertia body(masses[i], Vector3(centers + 3 * i),
                                Eigen::Matrix3d(Matrix3(inertias + 9 * i)));
        const std::string name = "joint" + std::to_string(i);
        if (prismatic[i])
            arm->model.addJoint(i, pin::JointModelPZ(), frame, name);
        else
            arm->model.addJoint(i, pin::JointModelRZ(), frame, name);
        arm->model.appendBodyToJoint(i + 1, body, pin::SE3::Identity());
    }
    arm->model.gravity.linear() = Vector3(gravity);
    arm->model.armature = copied(rotors, n);
    arm->effects = torques != nullptr;
    if (torques) {
        arm->limit = copied(torques, n);
        arm->damping = copied(torques + n, n);
        arm->friction = copied(torques + 2 * n, n);
        arm->width = copied(torques + 3 * n, n);
    }
    arm->data = std::make_unique<Data>(arm->model);
    return arm;
}

void aba(Arm *arm, long long count, const double *q, const double *qd, const double *tau,
         double *qdd) {
    each(*arm, count, q, qd, tau, qdd,
         [arm]() -> const VectorXd & { return aba_of(*arm, arm->q, arm->qd, arm->tau); });
}

void aba_world(Arm *arm, long long count, const double *q, const double *qd, const double *tau,
               double *qdd) {
    each(*arm, count, q, qd, tau, qdd, [arm]() -> const VectorXd & {
        return aba_of(*arm, arm->q, arm->qd, arm->tau, pin::Convention::WORLD);
    });
}

void crba(Arm *arm, long long count, const double *q, const double *qd, const double *tau,
          double *qdd) {
    each(*arm, count, q, qd, tau, qdd, [arm]() -> const VectorXd & {
        Data &data = *arm->data;
        pin::crba(arm->model, data, arm->q, pin::Convention::WORLD);
        arm->a1 = arm->tau - pin::nonLinearEffects(arm->model, data, arm->q, arm->qd);
        pin::cholesky::decompose(arm->model, data);
        pin::cholesky::solve(arm->model, data, arm->a1);
        return arm->a1;
    });
}

// The classical Runge-Kutta method: `substeps` steps of h seconds in each period, whose torques
// are a row of taus.
void rollout(Arm *arm, long long periods, long long substeps, double h, double *position,
             double *velocity, const double *taus) {
    Arm &r = *arm;
    const int n = r.model.nv;
    r.q = Input(position, n), r.qd = Input(velocity, n);
    for (long long k = 0; k < periods; k++) {
        r.tau = Input(taus + k * n, n);
        for (long long s = 0; s < substeps; s++) {
            r.a1 = acceleration(r, r.q, r.qd);
            r.v2 = r.qd + h / 2 * r.a1;
            r.x = r.q + h / 2 * r.qd;
            r.a2 = acceleration(r, r.x, r.v2);
            r.v3 = r.qd + h / 2 * r.a2;
            r.x = r.q + h / 2 * r.v2;
            r.a3 = acceleration(r, r.x, r.v3);
            r.v4 = r.qd + h * r.a3;
            r.x = r.q + h * r.v3;
            const VectorXd &a4 = acceleration(r, r.x, r.v4);
            r.q += h / 6 * (r.qd + 2 * r.v2 + 2 * r.v3 + r.v4);
            r.qd += h / 6 * (r.a1 + 2 * r.a2 + 2 * r.a3 + a4);
        }
    }
    Output(position, n) = r.q;
    Output(velocity, n) = r.qd;
}

}  // extern "C"
