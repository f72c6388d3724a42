# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A failing test leaves a recording and a page of each arm, and pytest names them."""

from __future__ import annotations

from pathlib import Path
import re

from bridge import pfd_main, read_contents
import numpy as np
from plugin_sessions import forked_session as session
import pytest

from pfd_ros import read_log

TESTS = """
import numpy as np
import pytest

def controller(t, q, qd):
    return -20.0 * q - 2.0 * qd + (5.0 if t > 0.1 else 0.0)

def test_settles(sim_arm):
    arm = sim_arm(robot='planar2', gravity=[0.0, 0.0, 0.0], external_wrench=True)
    arm.run(controller, 0.05)
    arm.push([0, 0, 0], [0, 0, 1.0])
    arm.reset()
    motion = arm.run(controller, 0.3)
    np.save('q.npy', motion.q)
    motion.assert_settles(0.0, within=1e-3, by=0.0)

def test_own_assertion(sim_arm, tmp_path):
    arm = sim_arm(robot='planar2')
    assert arm.run(controller, 0.2).q[-1, 0] == 7.0

def test_two_arms(sim_arm):
    for gravity in (0.0, -9.81):
        sim_arm(robot='planar2', gravity=[0.0, 0.0, gravity]).run(controller, 0.02)
    raise RuntimeError('</pre><script>alert(1)</script>')

def test_nan(sim_arm):
    sim_arm(robot='planar2').run(lambda t, q, qd: q * np.nan if t > 0.01 else 0 * q, 0.05)

def test_recorded(sim_arm, tmp_path):
    arm = sim_arm(robot='planar2', recording=tmp_path / 'own.mcap')
    arm.run(controller, 0.05)
    raise RuntimeError

def test_restored(sim_arm):
    arm = sim_arm(robot='planar2')
    arm.run(controller, 0.05)
    state = arm.save()
    arm.run(controller, 0.05)
    arm.restore(state)
    arm.run(controller, 0.02)
    raise RuntimeError

def test_passes(sim_arm):
    sim_arm(robot='planar2').run(controller, 0.02)

@pytest.mark.xfail
def test_xfail(sim_arm):
    sim_arm(robot='planar2').run(controller, 0.02)
    raise RuntimeError

def test_no_arm(sim_arm):
    raise RuntimeError
"""
FAILING = ('settles', 'own_assertion', 'two_arms', 'nan', 'recorded', 'restored')


@pytest.fixture(scope='module')
def failed(site: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Return the folder of a session, with its artifacts, and its output."""
    folder = tmp_path_factory.mktemp('session')
    return folder, session(site, folder, TESTS, ['--sim-arm-artifacts', 'left'], status=1)


def place(folder: Path, name: str) -> Path:
    return folder / 'left' / f'test_it.py_test_{name}'


def test_failing_tests_with_arms_leave_a_folder_that_the_report_names(
    failed: tuple[Path, str],
) -> None:
    folder, text = failed
    assert {path.name for path in (folder / 'left').iterdir()} == {
        f'test_it.py_test_{name}' for name in FAILING
    }
    for name in FAILING:
        arm = 'arm1' if name == 'two_arms' else 'arm'
        assert f'recording  {place(folder, name)}/{arm}.mcap' in text
        assert f'page       {place(folder, name)}/{arm}.html' in text
    assert 'not written' not in text


def test_the_recording_is_the_run_that_failed_bit_for_bit(failed: tuple[Path, str]) -> None:
    folder, _ = failed
    log = place(folder, 'settles') / 'arm.mcap'
    assert pfd_main(['replay', str(log), '--verify']) == 0
    recorded = read_log(log)['/joint_states'].position
    run = np.load(folder / 'q.npy')
    # The last row of a motion is one period before the last state.
    assert recorded[-len(run) : -1].tobytes() == run[1:].tobytes()


@pytest.mark.parametrize('name', FAILING[:4])
def test_recordings_of_unrecorded_runs_are_whole(
    failed: tuple[Path, str], name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    for log in place(failed[0], name).glob('*.mcap'):
        assert pfd_main(['replay', str(log), '--verify']) == 0
        assert 'verified' in capsys.readouterr().out


def test_the_page_marks_the_moment_of_the_assertion(failed: tuple[Path, str]) -> None:
    folder, text = failed
    expected = re.search(
        r"AssertionError: joint '\w+' is \S+ from its target 0 at t = (\S+) s", text
    )
    assert expected is not None
    page = (place(folder, 'settles') / 'arm.html').read_text(encoding='utf-8')
    assert f'failed assertion <button data-time="{float(expected[1])!r}">' in page
    # A plain assertion has no time: the end of the run is marked.
    page = (place(folder, 'own_assertion') / 'arm.html').read_text(encoding='utf-8')
    assert 'failed assertion <button data-time="0.201">' in page
    assert '== 7.0' in page


def test_the_text_of_an_error_is_escaped(failed: tuple[Path, str]) -> None:
    page = (place(failed[0], 'two_arms') / 'arm2.html').read_text(encoding='utf-8')
    assert '</pre><script>alert' not in page
    assert '&lt;/pre&gt;&lt;script&gt;alert(1)' in page


def test_the_input_that_was_rejected_is_on_the_page(failed: tuple[Path, str]) -> None:
    found = read_contents(place(failed[0], 'nan') / 'arm.mcap').findings
    (rejected,) = (f for f in found if f.kind == 'rejected input')
    assert 'not_finite' in rejected.text
    assert rejected.time == pytest.approx(0.011)


def test_of_a_restored_arm_the_states_since_then_are_written(failed: tuple[Path, str]) -> None:
    states = read_log(place(failed[0], 'restored') / 'arm.mcap')['/joint_states']
    assert states.time == pytest.approx(0.051 + 0.001 * np.arange(20))
    assert 'the log has its states since then' in ' '.join(failed[1].split())


FALLS = """
def test_falls(sim_arm):
    arm = sim_arm(robot='planar2')
    arm.run(lambda t, q, qd: 0 * q, 0.02).assert_settles(1.0, within=0.1, by=0.0)
"""


def test_without_the_option_the_folder_is_next_to_the_temporary_folder(
    site: Path, tmp_path: Path
) -> None:
    code = FALLS + FALLS.replace('falls(sim_arm)', 'with_a_folder(sim_arm, tmp_path)')
    session(site, tmp_path, code, ['--basetemp', str(tmp_path / 'base')], status=1)
    left = {path.name for path in (tmp_path / 'base').iterdir() if path.name.endswith('-sim_arm')}
    assert left == {'test_falls-sim_arm', 'test_with_a_folder0-sim_arm'}


def test_a_session_with_workers_keeps_the_artifacts_of_the_one_before(
    site: Path, tmp_path: Path
) -> None:
    (tmp_path / 'left' / 'test_it.py_test_falls').mkdir(parents=True)
    options = ['--sim-arm-artifacts', 'left', '-n', '1', '-p', 'xdist']
    text = session(site, tmp_path, FALLS, options, status=1)
    first, second = sorted((tmp_path / 'left').iterdir())
    assert (first.name, list(first.iterdir())) == ('test_it.py_test_falls', [])
    assert second.name == 'test_it.py_test_falls-2'
    assert f'recording  {second}/arm.mcap' in text


def test_a_folder_that_cannot_be_made_leaves_the_report_of_the_test(
    site: Path, tmp_path: Path
) -> None:
    (tmp_path / 'left').touch()
    text = session(site, tmp_path, FALLS, ['--sim-arm-artifacts', 'left'], status=1)
    assert 'expected within 0.1' in text
    assert 'no recording and no page: NotADirectoryError: ' in text


@pytest.mark.ros
def test_a_run_over_topics_is_recorded_again_with_the_bits_of_its_motion(
    site: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = """
import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

class Controller(Node):
    def __init__(self):
        super().__init__('controller')
        self.out = self.create_publisher(Float64MultiArray, 'sim_arm/commands', 1)
        self.create_subscription(JointState, 'joint_states', self.answer, 10)

    def answer(self, state):
        efforts = -5.0 * np.array(state.position) - np.array(state.velocity)
        self.out.publish(Float64MultiArray(data=efforts.tolist()))

def test_spins(sim_arm, ros_domain):
    node = Controller()
    motion = sim_arm(robot='planar2').spin(0.2, node)
    np.save('q.npy', motion.q)
    node.destroy_node()
    assert False
"""
    session(site, tmp_path, code, ['--sim-arm-artifacts', 'left'], status=1)
    log = tmp_path / 'left' / 'test_it.py_test_spins' / 'arm.mcap'
    assert pfd_main(['replay', str(log), '--verify']) == 0
    assert 'verified' in capsys.readouterr().out
    recorded = read_log(log)['/joint_states'].position
    assert recorded[:-1].tobytes() == np.load(tmp_path / 'q.npy')[1:].tobytes()


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.long
def test_of_an_arm_in_another_process_the_received_states_are_written(
    site: Path, tmp_path: Path
) -> None:
    code = """
def test_falls(sim_arm):
    arm = sim_arm(robot='planar2', process=True)
    arm.run(lambda t, q, qd: 0 * q, 0.05).assert_settles(1.0, within=0.1, by=0.0)
"""
    text = session(site, tmp_path, code, ['--sim-arm-artifacts', 'left'], status=1)
    assert 'the recording holds the states received here' in text
    folder = tmp_path / 'left' / 'test_it.py_test_falls'
    states = read_log(folder / 'arm.mcap')['/joint_states']
    assert len(states) == 50
    assert states.time[[0, -1]] == pytest.approx([0.001, 0.05])
    assert 'failed assertion <button data-time="0.001">' in (folder / 'arm.html').read_text()
