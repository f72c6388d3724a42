"""The control law on the simulated arm: a callback, no ROS."""

import numpy as np
import pytest

from joint_pd.control import DAMPING, STIFFNESS, JointPD

# A UR5 with rotor inertia and gravity compensation; a control period is a step of 1 ms.
UR5 = {'robot': 'ur5', 'armature': True, 'gravity_compensation': True}
GOAL = np.array([0.5, -1.0, 1.0, -0.5, 0.4, 0.3])


@pytest.fixture
def law():
    return JointPD(STIFFNESS, DAMPING, GOAL, duration=1.5)


def test_a_step_settles_without_overshoot_within_the_limits(sim_arm, law):
    motion = sim_arm(**UR5).run(law, 4.0)
    motion.assert_settles(GOAL, within=2e-3, by=3.0)
    motion.assert_overshoot_below(0.02, GOAL)
    motion.assert_torque_rate_below(1000.0)
    motion.assert_no_limit_hit()


@pytest.mark.parametrize('seed', range(3))
def test_it_settles_from_any_posture_nearby(sim_arm, law, seed):
    arm = sim_arm(**UR5)
    arm.set_state(GOAL + np.random.default_rng(seed).uniform(-0.5, 0.5, 6))
    arm.run(law, 4.0).assert_settles(GOAL, within=2e-3, by=3.0)


def test_it_bears_noise_and_delay_of_the_sensors(sim_arm, law):
    noisy = {'noise_position': 1e-4, 'noise_velocity': 1e-2, 'delay_state': 0.003}
    motion = sim_arm(**UR5, **noisy).run(law, 4.0)
    motion.assert_settles(GOAL, within=5e-3, by=3.0)
    # The limit is on clean torques: noise makes each of them jump.
    assert motion.torque_rate().max() > 1000.0


def test_a_push_moves_the_arm_as_far_as_its_stiffness_says(sim_arm, law):
    arm = sim_arm(**UR5, external_wrench=True)
    arm.run(law, 3.0)
    arm.push(force=[0.0, 0.0, 0.0], torque=[0.0, 0.0, 2.0])
    motion = arm.run(law, 3.0)
    # The moment is about the axis of the last joint.
    moved = motion.q[-1, 5] - GOAL[5]
    assert moved == pytest.approx(2.0 / STIFFNESS[5], rel=0.05)


def test_the_same_seed_gives_the_same_bits(sim_arm):
    runs = [
        sim_arm(**UR5, noise_velocity=1e-2, seed=7).run(
            JointPD(STIFFNESS, DAMPING, GOAL, duration=1.5), 0.5
        )
        for _ in range(2)
    ]
    assert (runs[0].q == runs[1].q).all()
