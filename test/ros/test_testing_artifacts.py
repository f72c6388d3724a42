# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pytest plugin in sessions of its own: fixtures, domains, and what failing tests leave."""

from __future__ import annotations

from contextlib import ExitStack
import os
from pathlib import Path
import re
import shutil
import socket
import subprocess
import sys
from typing import Any

import numpy as np
from plugin_sessions import fresh_session, session
import pytest
from ros_processes import PATIENCE, ROOT, wait_until

from pfd_ros import read_log
from pfd_ros.cli.main import main as pfd_main
from pfd_ros.testing import ControllerProcess, domains
from pfd_ros.testing.domains import claimed_domain, own_domain

# Tests that fail, each with a recording and a page of its arms, and tests that leave nothing.
TESTS = """
import sys
import pytest

def test_modules(pytestconfig):
    assert pytestconfig.pluginmanager.hasplugin('pfd_ros')
    for name in ('rclpy', 'pfd_core', 'numpy', 'pfd_ros.arm', 'pfd_ros.messages'):
        assert name not in sys.modules, name
    import numpy
    global np
    np = numpy

def controller(t, q, qd):
    return -20.0 * q - 2.0 * qd + (5.0 if t > 0.1 else 0.0)

def test_settles(sim_arm):
    arm = sim_arm(robot='planar2', external_wrench=True)
    arm.run(controller, 0.05)
    arm.push([0, 0, 0], [0, 0, 1.0])
    arm.run(controller, 0.02)
    arm.reset()
    motion = arm.run(controller, 0.3)
    np.save('q.npy', motion.q)
    motion.assert_settles(0.0, within=1e-3, by=0.0)

def test_own_assertion(sim_arm, tmp_path):
    arm = sim_arm(robot='planar2')
    assert arm.run(controller, 0.2).q[-1, 0] == 7.0

def test_two_arms(sim_arm):
    for _ in range(2):
        sim_arm(robot='planar2').run(controller, 0.02)
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

def test_caught(sim_arm):
    from pfd_ros.testing import ArmError
    arm = sim_arm(robot='planar2', joint_damping=[1e6, 1e6], integrator='rk4')
    with pytest.raises(ArmError):
        arm.run(controller, 0.05)
    arm.reset()
    with pytest.raises(ArmError):
        arm.run(controller, 0.05)
    raise RuntimeError

def test_passes(sim_arm):
    sim_arm(robot='planar2').run(controller, 0.02)
    assert 'rclpy' not in sys.modules

@pytest.mark.xfail
def test_xfail(sim_arm):
    sim_arm(robot='planar2').run(controller, 0.02)
    raise RuntimeError

def test_no_arm(sim_arm):
    raise RuntimeError
"""
FAILING = ('settles', 'own_assertion', 'two_arms', 'nan', 'recorded', 'caught', 'restored')
NODES = """
import os, signal, sys
import numpy as np
import pytest
import rclpy
from pfd_ros.testing import ControllerError, NodeProcess, NodeProcessError, process
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from tested_controllers import command_of, node_of

LEFT = []

def test_spins(sim_arm, ros_domain):
    assert rclpy.ok()
    assert os.environ['ROS_DOMAIN_ID'] == str(ros_domain)
    node = node_of('filter')
    motion = sim_arm(robot='ur5').spin(0.1, node)
    np.save('spun.npy', motion.q)
    # It must not be a peer in the next test.
    LEFT.append(node)
    assert False

def test_processes(sim_arm, controller_process, sim_node):
    process, slow = controller_process(command_of('states')), 240.0
    motion = sim_arm(robot='ur5').spin(0.02, process, patience=slow, start_patience=slow)
    assert motion.notes == []

def test_the_node(sim_node, tmp_path, monkeypatch):
    assert sim_node(robot='planar2', autostart=False).end() == ''
    # Names of parameters or of settings, and numbers of single joints.
    more = {'bias_position': {'elbow': 0.25}, 'bias.velocity.elbow': 0.5}
    more |= {'robot': 'planar2', 'recording': tmp_path / 'left.mcap'}
    with pytest.raises(NodeProcessError, match='status 1(.|\\n)*the recording is incomplete'):
        with NodeProcess(more, ['-r', '__ns:=/left']) as node:
            reader, states = rclpy.create_node('reader'), []
            reader.create_subscription(JointState, '/left/joint_states', states.append, 10)
            while len(states) < 2:
                rclpy.spin_once(reader)
            assert (states[1].position[1], states[1].velocity[1]) == (0.25, 0.5)
            assert node.end() == ''
            # The error is for the test: it is not one of the fixture as well.
            with pytest.raises(NodeProcessError, match='status 1(.|\\n)*the file exists'):
                sim_node(**more, ros_args=['-r', '__ns:=/right'])
            more['recording'].unlink()
    with pytest.raises(NodeProcessError, match='ended by SIGKILL'):
        with NodeProcess({'robot': 'planar2'}) as node:
            os.kill(node.pid, 9)
            node.process.wait()
    monkeypatch.setattr(process, 'NODE_END_SECONDS', 0.0)
    with pytest.raises(NodeProcessError, match='the node did not end within 0 s'):
        with NodeProcess({'robot': 'planar2'}) as node:
            os.kill(node.pid, signal.SIGSTOP)

def test_a_wait_in_c_ends(sim_arm, ros_domain):
    node = node_of('timer')
    second = Duration(seconds=1)
    node.create_subscription(
        Clock, '/clock', lambda tick: node.get_clock().sleep_for(second), 1)
    with pytest.raises(ControllerError, match='blocks: no answer for 1 s(.|\\n)*sleep_for'):
        sim_arm(robot='ur5').spin(0.1, node, patience=1.0)

def test_none():
    assert not rclpy.ok()
    # A test may do it all by itself.
    rclpy.init(domain_id=5)

def test_that_of_the_user(ros_domain):
    assert ros_domain == 5

def test_left_alone():
    assert rclpy.ok()
    rclpy.shutdown()
"""


@pytest.fixture(scope='module')
def failed(site: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Return the folder of a session, with its artifacts, and its output."""
    folder = tmp_path_factory.mktemp('session')
    return folder, fresh_session(site, folder, TESTS, ['--sim-arm-artifacts', 'left', '-rA'], 1)


def place(folder: Path, name: str) -> Path:
    return folder / 'left' / f'test_it.py_test_{name}'


def test_a_session_that_does_not_use_the_plugin_imports_neither_ros_nor_the_library(failed):
    assert 'PASSED test_it.py::test_modules' in failed[1]
    assert 'PASSED test_it.py::test_passes' in failed[1]


def test_a_failed_assertion_shows_the_line_of_the_test_and_none_of_the_helper(failed):
    assert re.search(r'^test_it\.py:\d+: AssertionError', failed[1], re.MULTILINE)
    assert 'trajectory.py' not in failed[1]


def test_failing_tests_with_arms_leave_a_folder_that_the_report_names(failed):
    folder, text = failed
    assert {path.name for path in (folder / 'left').iterdir()} == {
        f'test_it.py_test_{name}' for name in FAILING
    }
    for name in FAILING:
        arm = 'arm1' if name == 'two_arms' else 'arm'
        assert f'recording  {place(folder, name)}/{arm}.mcap' in text
        assert f'page       {place(folder, name)}/{arm}.html' in text
    assert 'not written' not in text
    assert 'its last state differs' not in text


def test_the_recording_is_the_run_that_failed_bit_for_bit(failed):
    folder, _ = failed
    recorded = read_log(place(folder, 'settles') / 'arm.mcap')['/joint_states'].position
    run = np.load(folder / 'q.npy')
    # The last row of a motion is one period before the last state.
    assert recorded[-len(run) : -1].tobytes() == run[1:].tobytes()


@pytest.mark.parametrize('name', FAILING[:6])
def test_recordings_of_failed_runs_verify(failed, name, capsys):
    logs = list(place(failed[0], name).glob('*.mcap'))
    assert logs
    for log in logs:
        assert pfd_main(['replay', str(log), '--verify']) == 0
        assert 'every bit equal' in capsys.readouterr().out


def test_of_a_restored_arm_the_recording_begins_with_the_state(failed):
    states = read_log(place(failed[0], 'restored') / 'arm.mcap')['/joint_states']
    assert states.stamp_ns.tolist() == [10**6 * k for k in range(52, 72)]
    assert 'the log begins there, not verifiable' in ' '.join(failed[1].split())


def test_the_page_marks_the_moment_of_the_assertion_and_the_push(failed):
    folder, text = failed
    found = re.search(r"AssertionError: joint '\w+' is \S+ rad from .* at t = (\S+) s", text)
    assert found is not None
    # A plain assertion has no time: the end of the run is marked.
    for name, time in (('settles', float(found[1])), ('own_assertion', 0.201)):
        page = (place(folder, name) / 'arm.html').read_text(encoding='utf-8')
        marked = re.search(r'failed assertion at (\S+) s<', page)
        assert marked is not None
        assert float(marked[1]) == pytest.approx(time, abs=1e-6)
        pushed, reason = '[0.0, 0.0, 1.0] N m' in page, '== 7.0' in page
        assert (pushed, reason) == (name == 'settles', name == 'own_assertion')
        # A reset ends a push.
        spans = re.findall(r'\[([\d.]+),([\d.]+),"push"', page)
        assert [[round(float(x), 6) for x in span] for span in spans] == [[0.051, 0.071]] * pushed


def test_the_text_of_an_error_is_escaped_on_the_page(failed):
    page = (place(failed[0], 'two_arms') / 'arm2.html').read_text(encoding='utf-8')
    assert '</pre><script>alert' not in page
    assert '&lt;/pre&gt;&lt;script&gt;alert(1)' in page


def test_the_input_that_was_rejected_is_on_the_page(failed):
    page = (place(failed[0], 'nan') / 'arm.html').read_text(encoding='utf-8')
    assert 'not_finite' in page


FALLS = """
def test_falls(sim_arm):
    arm = sim_arm(robot='planar2')
    arm.run(lambda t, q, qd: 0 * q, 0.02).assert_settles(1.0, within=0.1, by=0.0)
"""


def test_without_the_option_the_folder_is_next_to_the_temporary_folder(site, tmp_path):
    code = FALLS + FALLS.replace('falls(sim_arm)', 'with_a_folder(sim_arm, tmp_path)')
    session(site, tmp_path, code, ['--basetemp', str(tmp_path / 'base')], status=1)
    left = {path.name for path in (tmp_path / 'base').iterdir() if path.name.endswith('-sim_arm')}
    assert left == {'test_falls-sim_arm', 'test_with_a_folder0-sim_arm'}


def test_a_session_with_workers_keeps_the_artifacts_of_the_one_before(site, tmp_path):
    (tmp_path / 'left' / 'test_it.py_test_falls').mkdir(parents=True)
    options = ['--sim-arm-artifacts', 'left', '-n', '1', '-p', 'xdist']
    text = session(site, tmp_path, FALLS, options, status=1)
    first, second = sorted((tmp_path / 'left').iterdir())
    assert (first.name, list(first.iterdir())) == ('test_it.py_test_falls', [])
    assert second.name == 'test_it.py_test_falls-2'
    assert f'recording  {second}/arm.mcap' in text


def test_a_folder_that_cannot_be_made_leaves_the_report_of_the_test(site, tmp_path):
    (tmp_path / 'left').touch()
    options = ['--sim-arm-artifacts', 'left']
    text = session(site, tmp_path, FALLS, options, status=1)
    assert 'expected within 0.1' in text
    assert 'no recording and no page: NotADirectoryError: ' in text


@pytest.mark.ros
@pytest.mark.slow
def test_nodes_processes_and_the_node_itself_are_in_the_domain_of_the_test(
    site, tmp_path, capsys, monkeypatch
):
    monkeypatch.setenv('PYTHONPATH', str(ROOT / 'test' / 'ros'))
    options = ['--sim-arm-artifacts', 'left']
    text = session(site, tmp_path, NODES, options, status=1)
    assert '1 failed, 6 passed in ' in text
    log = tmp_path / 'left' / 'test_it.py_test_spins' / 'arm.mcap'
    assert pfd_main(['replay', str(log), '--verify']) == 0
    assert 'every bit equal' in capsys.readouterr().out
    recorded = read_log(log)['/joint_states'].position
    assert recorded[:-1].tobytes() == np.load(tmp_path / 'spun.npy')[1:].tobytes()


@pytest.mark.ros
@pytest.mark.slow
def test_workers_have_separate_domains(site, tmp_path):
    code = """
import pathlib, time
import pytest

@pytest.mark.parametrize('number', range(2))
def test_domain(ros_domain, number, worker_id):
    here = pathlib.Path(__file__).parent
    (here / f'{worker_id}.txt').write_text(str(ros_domain))
    for _ in range(10_000):
        found = list(here.glob('gw*.txt'))
        if len(found) == 2 and all(path.read_text() for path in found):
            break
        time.sleep(0.02)
    assert len({path.read_text() for path in found}) == 2
"""
    assert '2 passed' in session(site, tmp_path, code, ['-n', '2', '-p', 'xdist'])


# Domains.


def test_a_claimed_domain_leads_to_no_other_system_and_leaves_the_environment_as_it_was(
    monkeypatch,
):
    hostile = {'ROS_DISCOVERY_SERVER': 'x', 'ROS_STATIC_PEERS': 'x', 'FASTDDS_STATISTICS': 'x'}
    for name, value in {**hostile, 'ROS_DOMAIN_ID': '7', 'ROS_LOG_DIR': 'logs'}.items():
        monkeypatch.setenv(name, value)
    before = dict(os.environ)
    with claimed_domain() as domain:
        assert os.environ['ROS_DOMAIN_ID'] == str(domain)
        assert os.environ['ROS_LOG_DIR'] == 'logs'
        assert hostile.keys().isdisjoint(os.environ)
    assert dict(os.environ) == before


def test_a_claimed_domain_is_passed_over_and_free_again_after_its_process():
    with own_domain() as one, own_domain() as other:
        assert one != other
        assert 1 <= min(one, other) <= max(one, other) <= 101
        with own_domain(start=one - 1, avoided=str(one % 101 + 1)) as third:
            assert third not in (one, other, one % 101 + 1)
    # A process that is killed keeps no claim, whatever its temporary folder is.
    code = (
        'import os; from pfd_ros.testing.domains import own_domain; '
        f'claim = own_domain(start={one - 1}); print(claim.__enter__(), flush=True); os._exit(1)'
    )
    env = {**os.environ, 'PYTHONPATH': os.pathsep.join([str(ROOT), str(ROOT / 'test')])}
    options: dict[str, Any] = {'capture_output': True, 'text': True, 'check': False, 'env': env}
    done = subprocess.run([sys.executable, '-c', code], timeout=PATIENCE, cwd=ROOT, **options)
    with own_domain(start=int(done.stdout) - 1) as again:
        assert again == int(done.stdout)
    with ExitStack() as claims:
        found: list[int] = []

        def claim_all():
            while True:
                found.append(claims.enter_context(own_domain()))

        # Other processes may have some.
        with pytest.raises(OSError, match='all ROS domains from 1 to 101 are taken'):
            claim_all()
    assert len(set(found)) == len(found) > 50


def test_a_domain_in_which_a_participant_runs_is_passed_over():
    with own_domain() as first:
        pass
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        port = domains.PORT_BASE + domains.PORT_GAIN * first + domains.PARTICIPANT_PORT
        participant.bind(('', port))
        with own_domain(start=first - 1) as found:
            assert found != first


# Processes that may be killed share no memory.


CONTROLLER = """
from pathlib import Path
import rclpy
rclpy.init()
rclpy.create_node('controller')
print('shares memory:', '/dev/shm/fast' in Path('/proc/self/maps').read_text())
"""


@pytest.mark.ros
def test_a_controller_process_that_may_be_killed_shares_no_memory():
    with claimed_domain(), ControllerProcess([sys.executable, '-c', CONTROLLER]) as controller:
        wait_until(controller.end, controller.text, pause=0.05)
        assert controller.end() == 'ended with status 0', controller.text()
        assert 'shares memory: False' in controller.text()


HERE = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'PATH': '/bin'}


@pytest.mark.parametrize('rmw', [{}, {'RMW_IMPLEMENTATION': 'rmw_fastrtps_cpp'}])
def test_a_process_to_kill_gets_the_profile_and_keeps_its_other_variables(rmw):
    assert domains.environment_to_kill(HERE | rmw) == HERE | rmw | domains.LOOPBACK
    assert Path(domains.LOOPBACK['FASTRTPS_DEFAULT_PROFILES_FILE']).is_file()


@pytest.mark.parametrize(
    'chosen',
    [
        {'FASTDDS_DEFAULT_PROFILES_FILE': 'mine.xml'},
        {'FASTRTPS_DEFAULT_PROFILES_FILE': 'mine.xml'},
        {'RMW_IMPLEMENTATION': 'rmw_cyclonedds_cpp'},
        {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'},
    ],
    ids=str,
)
def test_a_profile_a_middleware_or_a_range_of_the_user_stays(chosen):
    assert domains.environment_to_kill(HERE | chosen) == HERE | chosen


# The code of README and guides.


def test_the_test_in_the_readme_passes_and_fails_with_the_sentence_shown(sim_arm):
    page = (ROOT / 'README.md').read_text(encoding='utf-8')
    (code,) = re.findall('```py\n(.*?)```', page, re.S)
    names: dict[str, Any] = {}
    exec(code, names)
    names['test_controller_settles'](sim_arm)
    (change,) = re.findall(r'# add (\S+) to the settings to see it fail', code)
    loaded = code.replace('gravity_compensation=True', f'gravity_compensation=True, {change}')
    exec(loaded, names)
    with pytest.raises(AssertionError) as failed:
        names['test_controller_settles'](sim_arm)
    assert f'`{str(failed.value).splitlines()[1].strip()}`' in page


@pytest.mark.ros
@pytest.mark.slow
def test_the_tests_of_nodes_in_the_guide_pass(site, tmp_path, monkeypatch):
    text = (ROOT / 'docs/guides/testing-a-controller.md').read_text(encoding='utf-8')
    monkeypatch.chdir(tmp_path)
    (command,) = re.findall(r'`pfd (init .*?)`', text)
    # Of two joints, with a quarter of the messages: in less time.
    assert pfd_main(command.replace('ur5', 'planar2').split()) == 0
    # The settings and the goal of the first block, which test_docs.py runs.
    lines = re.findall(r'^(?:import numpy|goal = |ur5 = ).*$', text, re.MULTILINE)
    code = '\n'.join([*lines, *re.findall('```py\n(.*?)```', text, re.S)])
    code = code.replace('glue = {', "glue = {'publish_rate': 250.0, ")
    package = tmp_path / 'my_controller'
    shutil.rmtree(package / 'test')
    assert '3 passed' in session(site, package, code)
