"""The node over real topics; ROS runs in a domain that no other test uses."""

import numpy as np
import pytest

pytest.importorskip('rclpy')

UR5 = {'robot': 'ur5', 'armature': True, 'gravity_compensation': True}
GOAL = np.array([0.5, -1.0, 1.0, -0.5, 0.4, 0.3])
# The arm takes commands where the controller publishes them.
GLUE = ['-r', '~/commands:=/effort_controllers/commands']


@pytest.fixture
def node(ros_domain):
    from joint_pd.node import JointPDNode

    found = JointPDNode(GOAL)
    yield found
    found.destroy_node()


def test_the_node_moves_the_arm_to_its_goal(sim_arm, node):
    motion = sim_arm(**UR5, ros_args=GLUE).spin(4.0, node)
    motion.assert_settles(GOAL, within=2e-3, by=3.0)
    motion.assert_no_limit_hit()


def test_the_node_has_the_same_bits_in_each_run(sim_arm, node, tmp_path):
    log = tmp_path / 'run.mcap'  # `pfd replay --verify` simulates it again
    first = sim_arm(**UR5, ros_args=GLUE, recording=log).spin(1.0, node)
    second = sim_arm(**UR5, ros_args=GLUE).spin(1.0, node)
    assert first.notes == []  # why a run may differ another time
    assert (first.q == second.q).all()
    assert log.exists()
