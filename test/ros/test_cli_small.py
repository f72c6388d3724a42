# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The small commands of `pfd`: robots, urdf, send and doctor."""

from __future__ import annotations

import re

import numpy as np
import pytest
from test_cli import command, installed, process

import pfd_core as pfd
from pfd_ros.cli import doctor
from pfd_ros.cli.send import message_of

# The small commands.


def test_robots_lists_each_robot_and_the_version_is_that_of_the_library(monkeypatch, tmp_path):
    for variable in ('AMENT_PREFIX_PATH', 'ROS_PACKAGE_PATH'):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv('ROBOT_DESCRIPTIONS_CACHE', str(tmp_path))
    assert command('--version') == (0, f'pfd {pfd.__version__}\n', '')
    status, printed, _ = command('robots')
    assert status == 0
    table, _, remedy = printed.partition('\n\n')
    heads = [line for line in table.splitlines() if not line.startswith(' ')]
    names = [*pfd.known_robots(), *pfd.known_robots(described=True)]
    assert [line.split()[0] for line in heads] == names
    assert any('6 joints: joint1, joint2' in line for line in heads)
    assert (
        'values for joint_limits, effort_limits; none for damping, armature, friction' in printed
    )
    (absent,) = re.findall('pfd urdf (\\w+)', remedy)
    status, _, said = command('urdf', absent)
    assert (status, 'Get one: ' in said) == (1, True)
    # Of example-robot-data, which pip installs.
    assert re.search(r'^xarm7 .*joint7\n .*none for armature\n .*xarm7\.urdf$', printed, re.M)


def test_urdf_prints_the_bytes_that_it_writes_also_where_stdout_is_ascii(tmp_path):
    assert command('urdf', 'planar2', '--out', f'{tmp_path}/arm.urdf') == (0, '', '')
    text = (tmp_path / 'arm.urdf').read_text(encoding='utf-8')
    assert pfd.load_robot(text).joint_names == pfd.load_robot('planar2').joint_names
    assert command('urdf', 'planar2') == (0, text, '')
    named = re.sub('<robot name="[^"]*"', '<robot name="é"', text)
    (tmp_path / 'arm.urdf').write_text(named, encoding='utf-8')
    with (tmp_path / 'printed').open('w') as printed:
        process('urdf', f'{tmp_path}/arm.urdf', stdout=printed, PYTHONIOENCODING='ascii')
    assert (tmp_path / 'printed').read_text(encoding='utf-8') == named


def test_urdf_of_a_xacro_file_takes_its_arguments(tmp_path):
    head = '<robot name="$(arg name)" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    path = tmp_path / 'arm.xacro'
    path.write_text(re.sub('<robot[^>]*>', head, pfd.urdf_of('planar2')))
    status, text, _ = command('urdf', str(path), 'name:=my_arm')
    assert (status, pfd.load_robot(text).name) == (0, 'my_arm')
    status, _, error = command('urdf', str(path), 'name')
    assert (status, error) == (
        1,
        "pfd urdf: 'name' is no argument of a .xacro file, expected name:=value\n",
    )


@pytest.mark.parametrize('robot', ['ur55', '/nowhere/arm.urdf'])
def test_urdf_of_an_unknown_robot_is_one_line(robot):
    status, _, error = command('urdf', robot)
    assert status == 1
    assert re.fullmatch(f'pfd urdf: .*{robot}.*\n', error)


ARRAY, NUMBER, JOINTS = (
    'std_msgs/msg/Float64MultiArray',
    'std_msgs/msg/Float64',
    'sensor_msgs/msg/JointState',
)


@pytest.mark.ros
@pytest.mark.parametrize(
    ('kind', 'values', 'field', 'expected'),
    [
        (ARRAY, ['1', '-2.5e3', 'nan'], 'effort', {'data': [1.0, -2500.0, float('nan')]}),
        (NUMBER, ['0.5'], 'effort', {'data': 0.5}),
        (JOINTS, ['a=1', 'b/c=-2'], 'effort', {'name': ['a', 'b/c'], 'effort': [1.0, -2.0]}),
        (JOINTS, ['a=b=1'], 'position', {'name': ['a=b'], 'position': [1.0], 'effort': []}),
        (NUMBER, ['1', '2'], 'effort', 'cannot make a std_msgs/msg/Float64 of '),
        ('std_msgs/msg/Bool', ['1'], 'effort', 'cannot make a std_msgs/msg/Bool'),
        (ARRAY, ['1', 'x'], 'effort', 'a value must be a number'),
        (ARRAY, ['a=1'], 'effort', 'cannot make a std_msgs/msg/Float64MultiArray'),
        (JOINTS, ['1'], 'effort', 'needs JOINT=NUMBER'),
        (JOINTS, ['a=1', 'a=2'], 'effort', 'each once'),
        (JOINTS, ['a='], 'effort', 'a value must be a number'),
    ],
)
def test_values_become_a_message_of_the_type_or_an_error_that_names_them(
    kind, values, field, expected
):
    if isinstance(expected, str):
        with pytest.raises(ValueError, match=expected):
            message_of(kind, values, field)
        return
    message = message_of(kind, values, field)
    for name, value in expected.items():
        found = getattr(message, name)
        assert str(found if isinstance(value, float) else [*found]) == str(value)


# Words, status, and the output of `pfd send` at an arm whose elbow is locked. Those of a row are
# sent at once, of which the arm may reject one; it moves after the last row.
SENT = [
    [
        (
            '/joint_commands shoulder=3.5 elbow=1 shouldr=1',
            1,
            r'pfd send: nothing sent to /joint_commands: no moving joints of an arm are '
            r"\['elbow', 'shouldr'\]; known are \['shoulder'\]\n",
        ),
        (
            '/nobody 1 --patience 0.5',
            1,
            r'pfd send: no subscriber to /nobody within 0\.5 s in .*\n',
        ),
        (
            '/sim_arm/commands 1 2',
            1,
            r'pfd send: rejected by /sim_arm: .* .commands wrong_size.\n',
        ),
    ],
    [
        (
            '/joint_commands shoulder=1 --field position',
            1,
            r'pfd send: rejected by /sim_arm: .* .joint_commands no_effort.\n',
        )
    ],
    *(
        [(words, 0, f'sent sensor_msgs/msg/JointState to {words.split()[0]}\n')]
        for words in (
            # A state may name locked joints.
            '/sim_arm/set_state shoulder=0.5 elbow=0 --field position',
            '/joint_commands shoulder=3.5',
        )
    ),
]


def test_send_reaches_an_arm_or_fails_with_the_reason_why_it_does_not(processes, peer_of):
    arm, peer = processes.arm('robot:=planar2', 'locked:=[elbow]'), peer_of(processes)
    peer.connect()
    for rows in SENT:
        assert not peer.states[-1].velocity[0]
        started = [
            (processes.forked('pfd_ros.cli.main', 'send', *words.split()), status, printed)
            for words, status, printed in rows
        ]
        for done, status, printed in started:
            assert done.end() == status, done.text()
            assert re.fullmatch(printed, done.text()), done.text()
        peer.let_pass(10)
    peer.wait(lambda: abs(peer.states[-1].velocity[0]) > 0.01)
    arm.stop()


# The installation.

METADATA = """\
Metadata-Version: 2.1
Name: pfd_ros
Version: 0.1.0
Provides-Extra: plots
Provides-Extra: test
Requires-Dist: numpy
Requires-Dist: a-package-that-nobody-has>=1; extra == "plots"
Requires-Dist: pytest; extra == "test"
"""


@pytest.mark.slow
@pytest.mark.parametrize('middleware', ['', 'rmw_absent'])
def test_a_machine_has_a_line_for_each_subject_and_a_failure_is_status_1(processes, middleware):
    variables = {'RMW_IMPLEMENTATION': middleware} if middleware else {}
    done = process('doctor', ROS_DOMAIN_ID=str(processes.domain), **variables)
    lines = dict(line.split(maxsplit=1) for line in done.stdout.splitlines())
    assert {*lines} >= {'pfd', 'python', 'processor', 'compiler', 'cache', 'clock', 'speed'}
    assert (done.returncode, done.stderr) == (int(bool(middleware)), '')
    assert ('FAILED' if middleware else 'message received by another process') in lines['dds']
    assert 'residual' in lines['compiler']


@pytest.mark.ros
def test_an_invalid_domain_is_named_and_no_firewall(monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', '500')
    (found,) = doctor.dds()
    assert found.failed
    assert 'domainId is over 232' in found.text


@pytest.mark.parametrize(
    ('cache', 'failed', 'text'),
    [
        ('writable by all', True, 'writable by this user only'),
        ('', False, 'compiles its kernels again'),
        ('own', False, 'has 1 files'),
    ],
)
def test_a_cache_that_cannot_be_used_is_a_failure(cache, failed, text, tmp_path, monkeypatch):
    folder = tmp_path / 'cache'
    if cache:
        folder.mkdir(mode=0o700)
        folder.chmod(0o777 if cache == 'writable by all' else 0o700)
    monkeypatch.setenv('PFD_CACHE', str(folder) if cache else '')
    (found,) = doctor.cache()
    assert found.failed == failed
    assert text in found.text
    assert str(folder) in found.text or not cache


def test_a_bare_timer_skips_periods_that_have_passed():
    # A loop of 10 kHz for 20 ms; each wake-up is due at a multiple of the period, one or more on.
    periods = doctor.bare_timer(1e-4, 0.02)
    assert 1 <= len(periods) <= 201
    assert periods.sum() >= 0.02
    assert (periods > 0).all()


@pytest.mark.parametrize(('count', 'busy'), [(985, False), (500, True)])
def test_a_timer_that_misses_periods_is_a_finding(monkeypatch, count, busy):
    monkeypatch.setattr(
        'pfd_ros.cli.doctor.bare_timer', lambda period, length: np.full(count, length / count)
    )
    (found,) = doctor.clock()
    assert found.subject == 'clock'
    assert f'woke {count} times in 1 s, expected 1000' in found.text
    assert ('a busy machine' in found.text) == busy


def test_a_kernel_with_a_wrong_answer_is_a_failure(monkeypatch):
    right = pfd.compile_kernel

    class Wrong:
        compile_seconds = 0.0

        def __init__(self, robot):
            self.kernel = right(robot)

        def __call__(self, *given):
            return 1.001 * self.kernel(*given)

    monkeypatch.setattr(pfd, 'compile_kernel', Wrong)
    (found,) = doctor.compiler()
    assert found.failed


def test_a_missing_extra_is_named_with_the_command_that_installs_it(tmp_path, monkeypatch):
    folder = tmp_path / 'pfd_ros-0.1.0.dist-info'
    folder.mkdir()
    (folder / 'METADATA').write_text(METADATA, encoding='utf-8')
    monkeypatch.syspath_prepend(str(tmp_path))
    texts = [found.text for found in doctor.extras()]
    assert texts[0].startswith('plots: a-package-that-nobody-has not installed; needed for ')
    assert installed(texts[0]) == ['a-package-that-nobody-has>=1']
    assert texts[1] == 'test: installed'
