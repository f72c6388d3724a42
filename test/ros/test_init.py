# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd init`: its packages pass their tests and show faults; the action; launch files."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
import os
from pathlib import Path
import re
import runpy
import shutil
import subprocess
import sys
from types import ModuleType
from typing import Any
import xml.etree.ElementTree as ElementTree

import gripper_arm
from gripper_arm import ARM
from logs import STRING as STRING_TYPE
from logs import Row, joint_state, string, write_mcap
from plugin_sessions import session
import pytest
from ros_processes import HAS_ROS, PATIENCE, ROOT, example_robot
import yaml

import pfd_core as pfd
from pfd_ros import read_log
from pfd_ros.arm.settings import FIELDS
from pfd_ros.cli.main import main as pfd_main
from pfd_ros.testing import LockstepArm

CLEAN = shutil.ignore_patterns('.git', '.venv', 'build', 'install', '*.egg-info', '.*_cache')
ACTION = ROOT / '.github' / 'actions' / 'test-controller' / 'action.yml'
# What ruff checks in a package.
LINT = (
    'check --isolated --line-length 99 --select E,F,W,B,UP,C4,RET,SIM,PT',
    "format --check --isolated --line-length 99 --config format.quote-style='single'",
)
SLOW = pytest.mark.slow
WITHOUT_GRAVITY = 'pfd.Scene(armature=SCENE.armature, damping=SCENE.damping, gravity=None)'
# Of the states of a recorded arm, Hz.
RATE = 500.0


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with the URDF of an arm with a gripper, where commands run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'arm.urdf').write_text(gripper_arm.urdf(), encoding='utf-8')
    return tmp_path


def init(*words: str, name: str = 'mine') -> Path:
    assert pfd_main(['init', name, *words]) == 0
    return Path.cwd() / name


def parameters(package: Path) -> dict[str, Any]:
    text = (package / package.name / 'arm.yaml').read_text(encoding='utf-8')
    return {node: table['ros__parameters'] for node, table in yaml.safe_load(text).items()}


def record(folder: Path, name: str = 'run.mcap', **settings: Any) -> Path:
    path = folder / name
    settings = {'robot': folder / 'arm.urdf', 'locked': ['finger'], **settings}
    with LockstepArm(recording=path, **settings) as arm:
        arm.run(lambda t, q, qd: 0.0 * q, 0.1)
    return path


def replaced(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding='utf-8')
    assert old in text
    path.write_text(text.replace(old, new), encoding='utf-8')


# What a package is made of, and what its tests find.


@pytest.mark.parametrize(
    ('words', 'has_ros'),
    [
        pytest.param(['--urdf', 'arm.urdf'], False, id='urdf'),
        pytest.param(['--bag', 'run.mcap', '--ros2-control'], True, id='bag', marks=SLOW),
        pytest.param(['--robot', 'ur5'], True, id='robot', marks=SLOW),
    ],
)
def test_the_tests_of_a_package_pass(site, folder, words, has_ros):
    if has_ros and not HAS_ROS:
        pytest.skip('rclpy is not installed')
    if '--bag' in words:
        record(folder, publish_rate=RATE, **{'friction.elbow': 0.5})
    package = init(*words)
    if not has_ros:
        (package / 'conftest.py').write_text("import sys\nsys.modules['rclpy'] = None\n")
    assert ('8 passed' if has_ros else '6 passed, 2 skipped') in session(site, package)


@pytest.mark.parametrize(
    ('right', 'wrong', 'failed'),
    [
        pytest.param('w**2 * (r', '-(w**2) * (r', 6, marks=SLOW, id='sign'),
        pytest.param('w**2 * (r', '0.5 * w**2 * (r', 2, id='gain'),
        pytest.param('2 * w * (dr', '0.0 * (dr', 2, marks=SLOW, id='damping'),
        pytest.param('scene=SCENE)', f'scene={WITHOUT_GRAVITY})', 5, marks=SLOW, id='gravity'),
    ],
)
def test_a_fault_of_the_law_fails_tests_and_is_on_their_pages(site, folder, right, wrong, failed):
    package = init('--urdf', 'arm.urdf')
    replaced(package / 'mine' / 'law.py', right, wrong)
    options = ['-k', 'not node', '--sim-arm-artifacts', str(folder / 'pages')]
    assert f'{failed} failed' in session(site, package, options=options, status=1)
    pages = list((folder / 'pages').rglob('arm.html'))
    assert len(pages) == failed
    assert all('expected' in page.read_text(encoding='utf-8') for page in pages)


def test_a_gripper_in_the_chain_is_a_note_whose_advice_works(folder, capsys):
    z1 = str(example_robot('z1_description/urdf/z1.urdf'))
    init('--urdf', z1)
    advice = re.search("'jointGripper'.* --tip '(.*)' locks it", capsys.readouterr().out)
    assert advice
    found = parameters(init('--urdf', z1, '--tip', advice[1], name='again'))['sim_arm']
    assert found['locked'] == ['jointGripper']
    assert 'jointGripper' not in capsys.readouterr().out.partition(', locked')[0]


def test_an_arm_that_gravity_nearly_overloads_is_taken_with_a_note(site, folder, capsys):
    talos = str(example_robot('talos_data/robots/talos_left_arm.urdf'))
    assert pfd_main(['init', 'mine', '--urdf', talos]) == 1
    advice = re.search("'gripper_left_joint'.* --tip '(.*)' locks it", capsys.readouterr().err)
    assert advice
    package = init('--urdf', talos, '--tip', advice[1])
    assert re.search("note: joint 'arm_left_2_joint' is nearly too weak", capsys.readouterr().out)
    # Its friction is more than half of what the law answers to a large error.
    assert '2 passed' in session(site, package, options=['-k', 'friction or torques'])


def test_each_value_has_its_source_and_is_that_of_the_model(folder):
    package = init('--urdf', 'arm.urdf')
    lines = (package / 'mine' / 'arm.yaml').read_text(encoding='utf-8').splitlines()
    values = [line for line in lines if re.match(r' {4,}[^ #].*: [^#]', line)]
    assert len(values) > 10
    assert all('  # ' in line for line in values)
    found = parameters(package)
    arm = found['sim_arm']
    locked = dict(zip(arm['locked'], arm['locked_positions'], strict=True))
    robot = pfd.load_robot(package / 'mine' / 'arm.urdf', locked=locked)
    assert arm['tip_link'] == 'lower'
    assert locked.keys() == set(gripper_arm.FINGERS)
    assert arm['initial_positions'] == list(gripper_arm.START)
    estimated = pfd.estimated_armature(robot)
    assert list(arm['armature'].values()) == pytest.approx(estimated.tolist(), rel=1e-5)
    assert 'friction' not in arm
    assert robot.joint_names == gripper_arm.ARM


# Settings of a recorded arm, numbers in its package, and what is said not to be taken.
RECORDED = {
    'settings': (
        {'friction.elbow': 0.5, 'noise_velocity': 0.01, 'delay_commands': 0.002},
        {'friction': {'elbow': 0.5}},
        {'noise.velocity', 'delay.commands'},
    ),
    'convention': (
        {'convention': 'ur', 'viscous_scale': (0.5,) * 2, 'coulomb_scale': (0.5,) * 2}
        | {'load_mass': 1.0},
        {},
        {'convention', 'viscous_scale', 'coulomb_scale', 'load.mass'},
    ),
    'scene': (
        {'scene': 'scene.yaml', 'payload_mass': 2.0},
        {
            'gravity': [0.0, 0.0, -1.62],
            'armature': {'shoulder': 0.3, 'elbow': 0.2},
            'damping': {'shoulder': 1.5},
            'friction': {'shoulder': 0.25, 'elbow': 0.5},
            'joint_limits': True,
        },
        {'payload.mass', 'motor_lag of the scene', 'restitution of the scene'},
    ),
}
SCENE = pfd.Scene(
    gravity=(0.0, 0.0, -1.62),
    armature=[0.3, 0.2],
    damping={'shoulder': 1.5},
    friction=[0.25, 0.5],
    joint_limits='model',
    restitution=0.5,
    motor_lag=[0.01, 0.01],
)


@pytest.mark.parametrize(('settings', 'numbers', 'left'), RECORDED.values(), ids=RECORDED)
def test_a_recording_gives_its_arm_and_says_what_is_left(folder, capsys, settings, numbers, left):
    start = [0.25, -0.5]
    SCENE.save('scene.yaml')
    record(folder, publish_rate=RATE, initial_positions=start, **settings)
    arm = parameters(init('--bag', 'run.mcap'))['sim_arm']
    assert arm['publish_rate'] == RATE
    assert arm['initial_positions'] == start
    effects = ('gravity', 'armature', 'damping', 'friction', 'joint_limits')
    assert {key: arm[key] for key in effects if key in arm} == numbers
    found = re.search(
        r'of the settings of run.mcap, .* not taken: (.*)$', capsys.readouterr().out, re.M
    )
    told = set(found[1].split(', '))
    assert told >= left
    assert told.isdisjoint(arm)
    urdf = (folder / 'mine' / 'mine' / 'arm.urdf').read_text(encoding='utf-8')
    assert urdf == gripper_arm.urdf()


def test_a_recording_of_an_arm_without_rotors_has_advice_that_works(folder, capsys):
    # Without rotors the packages of many arms, such as Panda and Kinova, are refused.
    record(folder)
    assert 'armature' not in parameters(init('--bag', 'run.mcap'))['sim_arm']
    advice = re.search(r'record with (\w+):=(\w+)', capsys.readouterr().out)
    assert advice
    record(folder, 'again.mcap', **{advice[1]: advice[2]})
    found = parameters(init('--bag', 'again.mcap', name='again'))['sim_arm']
    assert found['armature'].keys() == {*ARM}


def test_a_recording_of_a_robot_by_name_gives_the_arm_without_its_locked_joint(folder):
    record(folder, robot='ur5', locked=['wrist_3_joint'], locked_positions=[0.7])
    package = init('--bag', 'run.mcap')
    arm = parameters(package)['sim_arm']
    found = pfd.load_robot(package / 'mine' / 'arm.urdf', tip=arm['tip_link'])
    recorded = pfd.load_robot('ur5', locked={'wrist_3_joint': 0.7})
    assert (found.joint_names, found.tip) == (recorded.joint_names, recorded.tip)
    assert found.inertias == pytest.approx(recorded.inertias, rel=1e-9, abs=1e-12)


@pytest.mark.parametrize(
    'text',
    [
        pytest.param(gripper_arm.urdf() + '<!-- end -->', id='comment-after-the-robot'),
        pytest.param(
            gripper_arm.with_block('<!-- <ros2_control> -->' + gripper_arm.block()),
            id='comment-with-a-block',
        ),
        pytest.param(
            gripper_arm.urdf().replace('<link', '<ros2_control name="a"/><link', 1),
            id='block-without-an-end',
        ),
        pytest.param(gripper_arm.with_block(''), id='without-a-block'),
    ],
)
def test_a_block_for_ros2_control_replaces_those_of_any_urdf(folder, text):
    (folder / 'arm.urdf').write_text(text, encoding='utf-8')
    root = ElementTree.parse(init('--urdf', 'arm.urdf', '--ros2-control') / 'mine' / 'arm.urdf')
    joints = [joint.get('name') for joint in root.findall('ros2_control/joint')]
    assert joints == list(gripper_arm.ARM)
    assert len(root.findall('ros2_control')) == 1
    for tag in ('link', 'joint'):
        given = ElementTree.fromstring(text).findall(tag)
        assert [x.get('name') for x in root.findall(tag)] == [x.get('name') for x in given]


def test_logs_of_real_arms_give_rate_and_start(folder, real_arms, tmp_path):
    log = real_arms / 'ur10_exciting_trajectory'
    # Its joints have the names of the UR5 that is included.
    package = init('--bag', str(log), '--robot', 'ur5')
    arm = parameters(package)['sim_arm']
    states = read_log(log)['/joint_states']
    column = [states.names.index(name) for name in pfd.load_robot('ur5').joint_names]
    assert arm['publish_rate'] == 125.0
    assert arm['initial_positions'] == pytest.approx(states.position[0][column].tolist(), rel=1e-4)


@pytest.mark.parametrize('kind', ['drivers begin with NaN', 'a node for each joint'])
def test_a_foreign_bag_gives_its_robot_the_first_finite_state_and_the_rate_of_the_stamps(
    folder, kind
):
    topics = {'/robot_description': STRING_TYPE}
    rows = [Row('/robot_description', 999.0, string(gripper_arm.urdf()))]
    for k in range(60):
        # Logged in bursts, as from a busy machine; the commands come first.
        at, stamp = 1000.0 + 0.1 * (k // 10) + 1e-5 * (k % 10), 1000.0 + k / RATE
        rows.append(Row('/a_joint_commands', at, joint_state(ARM, [9.0, 9.0], stamp=stamp)))
        q = [0.1, 0.2] if k > 2 else [0.3, float('nan')]
        parts = [ARM] if kind.startswith('drivers') else [ARM[:1], ARM[1:]]
        for names in parts:
            at += 1e-6
            values = [q[ARM.index(name)] for name in names]
            rows.append(Row('/left/joint_states', at, joint_state(names, values, stamp=stamp)))
    write_mcap(folder / 'bag.mcap', rows, topics)
    arm = parameters(init('--bag', 'bag.mcap'))['sim_arm']
    assert (arm['initial_positions'], arm['publish_rate']) == ([0.3, 0.2], RATE)


def test_a_bag_with_two_robots_is_refused_by_their_topics(folder, capsys):
    topics = dict.fromkeys(('/left/robot_description', '/right/robot_description'), STRING_TYPE)
    texts = gripper_arm.urdf(), gripper_arm.urdf().replace('mass value="1"', 'mass value="2"')
    rows = [Row(topic, 1.0, string(text)) for topic, text in zip(topics, texts, strict=True)]
    write_mcap(folder / 'bag.mcap', rows, topics)
    assert pfd_main(['init', 'mine', '--bag', 'bag.mcap']) == 1
    assert re.search('2 robots, on .*left.*right.*--urdf', capsys.readouterr().err)
    assert not (folder / 'mine').exists()


def test_a_package_is_formatted_and_free_of_lint(folder):
    package = init('--urdf', 'arm.urdf', '--ros2-control')
    for words in LINT:
        tool = Path(sys.executable).with_name('ruff')
        done = subprocess.run([tool, *words.split(), package], check=False, capture_output=True)
        assert done.returncode == 0, done.stdout.decode()


@pytest.mark.parametrize('control', [False, True], ids=['direct', 'ros2_control'])
def test_the_launch_file_starts_arm_and_controller(folder, control, recorder, monkeypatch):
    name = f'launched_{control}'.lower()
    package = init('--urdf', 'arm.urdf', *['--ros2-control'] * control, name=name)
    monkeypatch.syspath_prepend(str(package))
    started = nodes(package / 'launch' / 'arm.launch.py', recorder, folder / 'arm.urdf')
    found = [(node['package'], node['executable']) for node in started]
    own = [('pfd_ros', 'sim_node'), (name, name)]
    manager = [('controller_manager', x) for x in ('ros2_control_node', 'spawner')]
    assert found == own + manager * control
    file, changed = started[0]['parameters']
    assert Path(file) == package / name / 'arm.yaml'
    with LockstepArm(**parameters(package)['sim_arm'], **changed) as arm:
        assert arm.settings.command_topic == ('' if control else '/effort_controller/commands')
        # Hardware that talks over topics would be a second source of commands.
        expected = '/robot_joint_commands' if control else None
        assert arm._described.topics.get('joint_commands') == expected
        assert arm._described.warnings == ()
    if control:
        # The hardware has a node with the name of its block, which stamps the commands.
        block = ElementTree.parse(package / name / 'arm.urdf').find('ros2_control')
        text = (package / name / 'controllers.yaml').read_text(encoding='utf-8')
        assert yaml.safe_load(text)[block.get('name')]['ros__parameters']['use_sim_time'] is True


def test_the_node_begins_at_the_first_state_with_a_finite_number_for_each_joint(
    folder, ros_domain, monkeypatch
):
    from sensor_msgs.msg import JointState

    monkeypatch.syspath_prepend(str(init('--urdf', 'arm.urdf', name='finite')))
    node = import_module('finite.node').Controller()
    sent: list[Any] = []
    monkeypatch.setattr(node.commands, 'publish', sent.append)
    names, nan = list(gripper_arm.ARM), float('nan')
    still = [0.0, 0.0]
    for q, qd in (([nan, 0.2], still), ([0.1], [0.0]), ([0.1, 0.2], []), ([0.3, 0.4], still)):
        assert not sent
        node.on_state(JointState(name=names[: len(q)], position=q, velocity=qd))
    assert node.law.begin[1].tolist() == [0.3, 0.4]
    assert len(sent) == 1
    node.destroy_node()


# What is refused, and that nothing is left.


@pytest.mark.parametrize(
    ('name', 'words', 'reason'),
    [
        ('Mine', ['--urdf', 'arm.urdf'], "NAME must be of lower-case letters.* got 'Mine'"),
        ('my-arm', ['--urdf', 'arm.urdf'], 'NAME must be of .* underscores, got'),
        ('my__arm', ['--urdf', 'arm.urdf'], 'letter or digit after each underscore'),
        ('q', ['--urdf', 'arm.urdf'], 'two characters or more'),
        ('1st', ['--urdf', 'arm.urdf'], 'start with a letter'),
        ('class', ['--urdf', 'arm.urdf'], 'no keyword'),
        ('json', ['--urdf', 'arm.urdf'], 'no module of Python'),
        ('numpy', ['--urdf', 'arm.urdf'], 'no installed Python module'),
        ('test', ['--urdf', 'arm.urdf'], 'files and folders in the package'),
        ('pfd_ros', ['--urdf', 'arm.urdf'], 'no installed Python module'),
        ('../mine', ['--urdf', 'arm.urdf'], 'NAME must be'),
        ('there', ['--urdf', 'arm.urdf'], 'there exists'),
        ('mine', [], 'no arm; name one'),
        ('mine', ['--robot', 'ur55'], "unknown robot 'ur55'"),
        ('mine', ['--urdf', 'arm.urdf', '--tip', 'nail'], "'nail'"),
        ('mine', ['--urdf', 'weak.urdf'], "'elbow' cannot carry the arm: .* expected 0.5 at most"),
        ('mine', ['--urdf', 'narrow.urdf'], "joint 'elbow' would reach its limits"),
        ('mine', ['--urdf', 'light.urdf'], 'init: light.urdf, line 1: link .* no <inertial>'),
        ('mine', ['--bag', 'run.mcap', '--robot', 'ur5'], 'has no states of .*: leave out --bag'),
        ('mine', ['--bag', 'run.mcap', '--tip', 'upper'], "that of run.mcap, 'lower'"),
    ],
)
def test_what_cannot_be_done_is_refused_and_leaves_nothing(folder, capsys, name, words, reason):
    (folder / 'there').mkdir()
    text = gripper_arm.urdf()
    (folder / 'weak.urdf').write_text(text.replace('effort="90"', 'effort="1"'))
    (folder / 'light.urdf').write_text(re.sub('<inertial>.*?</inertial>', '', text))
    narrow = '<limit lower="-0.001" upper="0.001" velocity="9" effort="90"/>'
    narrow += '<dynamics friction="20"/>'
    shoulder, elbow, rest = text.split('<limit ', 2)
    rest = rest.partition('/>')[2]
    (folder / 'narrow.urdf').write_text(f'{shoulder}<limit {elbow}{narrow}{rest}')
    if '--bag' in words:
        record(folder)
    before = sorted(folder.rglob('*'))
    assert pfd_main(['init', name, *words]) == 1
    assert re.search(reason, capsys.readouterr().err)
    assert sorted(folder.rglob('*')) == before


def test_a_package_that_cannot_be_written_leaves_nothing(folder, monkeypatch):
    def full(self, target):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(Path, 'rename', full)
    assert pfd_main(['init', 'mine', '--urdf', 'arm.urdf']) == 1
    assert [path.name for path in folder.iterdir()] == ['arm.urdf']


# Builds, and the action.


def steps(values: dict[str, str]) -> list[dict[str, Any]]:
    """Return the steps of the action, with values in the place of expressions."""
    text = ACTION.read_text(encoding='utf-8')
    text = re.sub(r'\$\{\{ ([\w.]+) \}\}', lambda found: values[found[1]], text)
    return yaml.safe_load(text)['runs']['steps']


def test_a_package_has_the_action_of_this_repository(folder):
    package = init('--urdf', 'arm.urdf')
    path = ACTION.relative_to(ROOT)
    assert (package / path).read_bytes() == ACTION.read_bytes()
    jobs = yaml.safe_load((package / '.github/workflows/test.yml').read_text())['jobs']
    last = jobs['test']['steps'][-1]
    assert last['uses'] == f'./{path.parent.as_posix()}'
    given = yaml.safe_load(ACTION.read_text(encoding='utf-8'))['inputs']
    assert {*last['with']} == {name for name, row in given.items() if row.get('required')}


def test_the_action_without_sources_of_pfd_ros_names_the_variable_and_installs_nothing():
    names = ('inputs.package', 'inputs.pfd_ros', 'runner.temp')
    install = steps(dict.fromkeys(names, ''))[0]
    done = subprocess.run(
        [shutil.which('bash'), '-e', '-c', install['run']],
        env={'PATH': '', **install['env']},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert done.stderr.count('PFD_ROS: set it to') == 1
    assert 'python' not in done.stderr


@pytest.mark.slow
def test_the_steps_of_the_action_install_test_and_keep_pages(folder):
    package, home = init('--urdf', 'arm.urdf'), folder / 'runner'
    source = shutil.copytree(
        ROOT,
        folder / 'source',
        ignore=CLEAN,
    )
    subprocess.run([sys.executable, '-m', 'venv', '--without-pip', folder / 'env'], check=True)
    (site,) = (folder / 'env').glob('lib/python*/site-packages')
    # Other packages are those of this environment, and nothing is fetched.
    (site / 'others.pth').write_text(str(Path(pytest.__file__).parents[1]), encoding='utf-8')
    environment = {
        **os.environ,
        'PATH': f'{folder / "env" / "bin"}:{os.environ["PATH"]}',
        'PIP_NO_COMPILE': '1',
        'PIP_NO_DEPS': '1',
        'PIP_NO_BUILD_ISOLATION': '1',
        'RUNNER_TEMP': str(home),
        'PYTEST_ADDOPTS': '-k tracks',
    }
    values = {
        'inputs.package': str(package),
        'inputs.pfd_ros': str(source),
        'runner.temp': str(home),
    }
    home.mkdir()
    install, test, upload = steps(values)
    replaced(package / 'mine' / 'law.py', '(r - q)', '(q - r)')
    for step, status in ((install, 0), (test, 1)):
        done = subprocess.run(
            ['bash', '--noprofile', '--norc', '-eo', 'pipefail', '-c', step['run']],
            cwd=home,
            env={**environment, **step['env']},
            capture_output=True,
            text=True,
            check=False,
            timeout=10 * PATIENCE,
        )
        assert done.returncode == status, done.stdout
    assert upload['if'] == 'failure()'
    kept = {path.name for path in Path(upload['with']['path']).rglob('*') if path.is_file()}
    assert {'arm.html', 'arm.mcap'} <= kept


@pytest.mark.slow
def test_colcon_builds_a_package_and_pfd_ros_with_their_programs(folder):
    colcon = shutil.which('colcon', path=str(Path(sys.executable).parent))
    if colcon is None:
        pytest.skip('colcon is not installed')
    package = init('--urdf', 'arm.urdf', '--ros2-control')
    shutil.copytree(ROOT, folder / 'workspace/src/pfd_ros', ignore=CLEAN)
    package.rename(folder / 'workspace/src/mine')
    # A warning of setuptools on stderr is no failure; the exit status is.
    built = subprocess.run(
        [colcon, 'build'], cwd=folder / 'workspace', capture_output=True, text=True, check=False
    )
    assert built.returncode == 0, built.stdout + built.stderr
    mine, own = (folder / 'workspace/install' / name for name in ('mine', 'pfd_ros'))
    sites = [next(prefix.glob('lib/python*/site-packages')) for prefix in (mine, own)]
    for path in (
        *(mine / 'lib/mine/mine', mine / 'share/mine/launch/arm.launch.py'),
        *(sites[0] / 'mine' / name for name in ('arm.urdf', 'arm.yaml', 'controllers.yaml')),
        *(own / name for name in ('lib/pfd_ros/sim_node', 'share/pfd_ros/package.xml')),
    ):
        assert path.is_file(), path
    code = 'import mine.law; print(mine.law.ROBOT.joint_names, mine.law.__file__)'
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(map(str, sites))}
    for words, wanted in (
        (['-c', code], f'{gripper_arm.ARM} {sites[0]}'),
        ([own / 'lib/pfd_ros/pfd', 'robots'], 'panda'),
    ):
        command = [sys.executable, *words]
        told = subprocess.check_output(command, env=environment, cwd=folder, text=True)
        assert told.startswith(wanted)


FOLDER = Path(__file__).resolve().parents[2] / 'launch'
FILES = sorted(FOLDER.glob('*.launch.py'))
MODULES = {
    'launch': ['LaunchContext', 'LaunchDescription'],
    'launch.actions': ['DeclareLaunchArgument', 'OpaqueFunction'],
    'launch.substitutions': ['LaunchConfiguration'],
    'launch_ros': [],
    'launch_ros.actions': ['Node'],
    'launch_ros.parameter_descriptions': ['ParameterValue'],
}


class Recorded:
    """An object of a launch file that remembers its arguments."""

    def __init__(self, *args: Any, **named: Any) -> None:
        self.args, self.named = args, named

    def perform(self, values: dict[str, str]) -> str:
        return values[self.args[0]]


@pytest.fixture
def recorder(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, type[Recorded]]]:
    """Put classes that only remember in the place of those of launch."""
    kinds = {name: type(name, (Recorded,), {}) for names in MODULES.values() for name in names}
    for module, names in MODULES.items():
        stub = ModuleType(module)
        vars(stub).update({name: kinds[name] for name in names})
        monkeypatch.setitem(sys.modules, module, stub)
    return kinds


def nodes(path: Path, kinds: dict[str, type[Recorded]], urdf: Path) -> list[dict[str, Any]]:
    """Return the arguments of the nodes that a launch file starts."""
    (entities,) = runpy.run_path(str(path))['generate_launch_description']().args
    found = []
    for entity in entities:
        if isinstance(entity, kinds['OpaqueFunction']):
            found += entity.named['function']({'urdf': str(urdf)})
        elif isinstance(entity, kinds['Node']):
            found.append(entity)
    return [node.named for node in found]


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_a_launch_file_starts_arms_with_parameters_that_they_have(path, recorder, tmp_path):
    urdf = tmp_path / 'arm.urdf'
    urdf.write_text(gripper_arm.urdf())
    known = {row.name for row in FIELDS}
    started = nodes(path, recorder, urdf)
    arms = [node for node in started if node['package'] == 'pfd_ros']
    assert len(arms) == (2 if path.name.startswith('two') else 1)
    for arm in arms:
        assert (arm['executable'], arm['name']) == ('sim_node', 'sim_arm')
        (parameters,) = arm['parameters']
        assert set(parameters) <= known
    others = [node for node in started if node not in arms]
    assert all(node['parameters'][0]['use_sim_time'] is True for node in others)


def test_one_of_two_arms_publishes_the_clock_that_the_other_follows(recorder):
    arms = nodes(FOLDER / 'two_arms.launch.py', recorder, Path())
    keys = ('publish_clock', 'time_source')
    told = {arm['namespace']: [arm['parameters'][0][key] for key in keys] for arm in arms}
    assert told == {'left': [True, 'own'], 'right': [False, 'clock']}


@pytest.mark.ros
@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_a_launch_file_runs(path, tmp_path):
    launch = pytest.importorskip('launch')
    pytest.importorskip('launch_ros')
    from launch.actions import IncludeLaunchDescription, Shutdown, TimerAction
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    urdf = tmp_path / 'arm.urdf'
    urdf.write_text(gripper_arm.urdf())
    source = PythonLaunchDescriptionSource(str(path))
    service = launch.LaunchService(noninteractive=True)
    service.include_launch_description(
        launch.LaunchDescription(
            [
                IncludeLaunchDescription(source, launch_arguments=[('urdf', str(urdf))]),
                TimerAction(period=5.0, actions=[Shutdown()]),
            ]
        )
    )
    assert service.run() == 0
