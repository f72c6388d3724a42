# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two guides and the demo work as printed, and the site opens and searches without network."""

from __future__ import annotations

from contextlib import suppress
import os
from pathlib import Path
import re
import shlex
import shutil
import subprocess
import sys
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit
from xml.etree import ElementTree

from arm_messages import efforts as commanded
from arm_messages import made, wrench
from devtools import needs_browser
import gripper_arm
import numpy as np
from plugin_sessions import install
import pytest
from replicas import ControllerManager, TopicHardware
from ros_processes import (
    PATIENCE,
    ROOT,
    Process,
    Processes,
    description_publisher,
    environment,
    wait_until,
)
import yaml
from zoo import one_fast

import pfd_core as pfd
from pfd_ros import read_log
from pfd_ros.arm.events import LABELS as VERDICT_LABELS
from pfd_ros.arm.settings import Settings
from pfd_ros.demo import run, scenario
from pfd_ros.messages.joints import decode_joints
from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.replay.verify import verify as verify_log

TEXT = (ROOT / 'docs' / 'guides' / 'alongside-a-controller.md').read_text(encoding='utf-8')
NOTHING = (ROOT / 'docs' / 'reference' / 'topics.md').read_text(encoding='utf-8')
ARM = ('shoulder', 'elbow')


def blocks(kind: str) -> list[str]:
    return re.findall(rf'^```{kind}\n(.*?)^```$', TEXT, re.MULTILINE | re.DOTALL)


COMMANDS = [line for block in blocks('bash') for line in block.splitlines()]
(BLOCK,) = blocks('xml')
(CONTROLLERS,) = map(yaml.safe_load, blocks('yaml'))


def command(part: str) -> list[str]:
    """Return the arguments of the one command `pfd sim` that has this part."""
    (line,) = (line for line in COMMANDS if part in line)
    pfd, sim, *arguments = shlex.split(line)
    assert (pfd, sim) == ('pfd', 'sim')
    return arguments


def start(processes: Processes, part: str, *more: str, ready: bool = True) -> Process:
    (processes.folder / 'arm.urdf').write_text(gripper_arm.with_block(BLOCK))
    arm = processes.forked('pfd_ros.cli.main', 'sim', *command(part), *more)
    if ready:
        arm.wait_for_text('until its first command')
    return arm


def hardware_of(peer) -> TopicHardware:
    """Return a replica of the hardware that the block describes."""
    block = ElementTree.fromstring(BLOCK)
    told = {param.get('name'): param.text for param in block.findall('hardware/param')}
    commanded, held = (
        {
            joint.get('name'): [kind.get('name') for kind in joint.findall(f'{tag}_interface')]
            for joint in block.findall('joint')
        }
        for tag in ('command', 'state')
    )
    return TopicHardware(
        peer,
        commanded,
        held,
        float(told['trigger_joint_command_threshold']),
        (told['joint_commands_topic'], told['joint_states_topic']),
    )


RATE = CONTROLLERS['controller_manager']['ros__parameters']['update_rate']


def manager_of(peer) -> ControllerManager:
    """Return a replica of the controller manager, connected, whose controller commands 0.5 N m."""
    hardware = hardware_of(peer)
    manager = ControllerManager(peer, hardware, 1_000_000_000 // RATE)
    manager.start()
    peer.wait(lambda: hardware.latest.name and hardware.publisher.get_subscription_count())
    manager.update = lambda states: {joint: {'effort': 0.5} for joint in ARM}
    return manager


def test_every_command_is_run_by_a_test_of_this_file():
    source = Path(__file__).read_text(encoding='utf-8')
    parts = re.findall(r"start\(\s*processes, '(.*?)'", source)
    sims = [line for line in COMMANDS if line.startswith('pfd sim')]
    assert sorted(line for part in parts for line in sims if part in line) == sorted(sims)
    assert [line for line in COMMANDS if line not in sims] == ['python3 hold.py']


def test_lines_of_the_log_in_the_guide_are_logged_by_the_node():
    folder = ROOT / 'pfd_ros'
    others = (folder / 'arm' / 'advice.py', folder / 'messages' / 'matching.py')
    paths = [*folder.glob('node/*.py'), *others]
    source = ' '.join(path.read_text(encoding='utf-8') for path in paths)
    # Texts go over several lines of the source.
    source = re.sub(r"'\n\s+f?'", '', source)
    found = re.findall(r'^\| `(.*?)` \|', NOTHING.partition('## When nothing moves')[2], re.M)
    assert len(found) > 10
    for line in found:
        dropped = line.partition('rejected: ')[2]
        if dropped:
            assert dropped in VERDICT_LABELS
        elif line.endswith(' too'):
            assert re.search(r'publishes \{topic\} \{', source)
            assert "'too: " in source
        else:
            assert line in source, line


def test_the_manager_finds_a_model_and_its_controllers_and_all_nodes_have_simulated_time():
    # The hardware has a node with the name of its block, which takes nothing from the manager.
    hardware = ElementTree.fromstring(BLOCK).get('name')
    (spawner,) = (x for block in blocks('console') for x in block.splitlines() if 'spawner' in x)
    spawned = spawner.partition('spawner ')[2].split()
    manager = CONTROLLERS['controller_manager']['ros__parameters']
    assert all('type' in manager[name] for name in spawned)
    for node in ('controller_manager', hardware, 'effort_controller'):
        assert CONTROLLERS[node]['ros__parameters']['use_sim_time'] is True
    assert all(
        'publish_description:=true' in command(x)
        for x in ('recording:=run.mcap', 'lockstep:=true')
    )


@pytest.mark.slow
def test_ros2_control_needs_no_remapping(processes, peer_of):
    arm = start(processes, 'recording:=run.mcap')
    assert CONTROLLERS['effort_controller']['ros__parameters']['joints'] == list(ARM)
    peer = peer_of(processes)
    manager = manager_of(peer)
    hardware = manager.hardware
    peer.wait(lambda: manager.run(1) or hardware.states['elbow']['effort'] == 0.5)
    assert hardware.states['finger']['position'] == 0.04
    arm.stop()
    warnings = [line for line in arm.text().splitlines() if '[WARN]' in line]
    # On a busy machine steps are late, and publishers are discovered late.
    assert not [w for w in warnings if not re.search('periods missed|no publisher of commands', w)]
    path = processes.folder / 'run.mcap'
    assert verify_log(path).complete
    assert RecordedLog(path).settings.initial_positions == (0.5, 0.0)


@pytest.mark.slow
def test_in_lockstep_every_state_has_the_command_of_its_cycle(processes, peer_of):
    arm = start(processes, 'lockstep:=true', '-p', 'recording:=arm.mcap')
    peer = peer_of(processes)
    manager = manager_of(peer)
    hardware = manager.hardware
    # Until both are in step, the arm is not slower than the manager, and on a busy machine the
    # manager is some periods behind.
    peer.wait(
        lambda: manager.run(1) or (any(hardware.latest.effort) and manager.next_ns > manager.now())
    )
    manager.run(100)
    # A controller manager that has ended answers no more.
    arm.wait_for_text('s of waiting for commands in lockstep, now for the state at t = ')
    arm.stop()
    path = processes.folder / 'arm.mcap'
    assert verify_log(path).complete
    messages = list(RecordedLog(path).messages())
    # After a stall the arm sends its state again, and the second answer is stale. A rejection
    # follows the command that it is about.
    following = [message.role for message in messages[1:]] + ['']
    rejections = [message.data for message in messages if message.role == 'rejected']
    assert all(b'joint_commands stale' in data for data in rejections)
    taken = [
        message.cycle
        for message, role in zip(messages, following, strict=True)
        if message.role == 'joint_commands' and role != 'rejected'
    ]
    every = Settings(publish_rate=float(RATE)).publish_every
    assert len(taken) >= 100
    assert set(np.diff(taken[-90:])) == {every}


@pytest.mark.slow
def test_a_script_with_the_model_of_the_arm_holds_it(processes):
    start(processes, 'command_topic:=')
    (code,) = blocks('python hold.py')
    (processes.folder / 'hold.py').write_text(code)
    script = processes.python('hold.py')
    assert script.process.wait(PATIENCE) == 0, script.text()
    # A machine that is busy for a while lets the arm sink.
    assert float(re.search(r'(\S+) rad off', script.text())[1]) < 0.2


@pytest.mark.slow
def test_the_model_comes_from_the_topic(processes, peer_of):
    publish = description_publisher(peer_of(processes))
    publish(gripper_arm.with_block(BLOCK))
    arm = start(processes, 'robot:=robot_description')
    assert 'joint_commands is /robot_joint_commands, from <ros2_control>' in arm.text()


def test_two_arms_start_side_by_side(processes, peer_of):
    start(processes, '__ns:=/left', ready=False)
    start(processes, '__ns:=/right')
    left, right = (peer_of(processes, name) for name in ('left', 'right'))
    left.wait(lambda: left.states and left.clocks)
    right.wait(lambda: right.states)


# First ten minutes.

MINUTES = (ROOT / 'docs' / 'guides' / 'first-ten-minutes.md').read_text(encoding='utf-8')
# Kind and name of each block, and what is in it.
MINUTES_BLOCKS = re.findall(r'^```(\w+) ?(.*)\n((?s:.*?))^```$', MINUTES, re.MULTILINE)
FILES = {name: body for _, name, body in MINUTES_BLOCKS if '.' in name}
MINUTES_COMMANDS = [(name, body) for kind, name, body in MINUTES_BLOCKS if kind == 'sh']


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with the files of the guide, from which a test imports."""
    for name, body in FILES.items():
        (tmp_path / name).write_text(body, encoding='utf-8')
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, 'law', raising=False)
    return tmp_path


def test_the_controller_passes_its_test_and_fails_with_an_unknown_load(folder, sim_arm):
    names: dict = {}
    exec(FILES['test_law.py'], names)
    names['test_the_arm_settles'](sim_arm)
    (change,) = re.findall(r"sed 's/(.*)/(.*)/' test_law.py", MINUTES)
    assert change[0] in FILES['test_law.py']
    exec(FILES['test_law.py'].replace(*change), names)
    with pytest.raises(AssertionError, match='shoulder: rests'):
        names['test_the_arm_settles'](sim_arm)


@pytest.mark.long
def test_every_command_of_the_guide_works_as_printed(folder, processes, tmp_path_factory):
    site = tmp_path_factory.mktemp('site')
    install(site)
    (site / 'pfd').write_text(f'#!/bin/sh\nexec {sys.executable} -m pfd_ros.cli.main "$@"\n')
    (site / 'pytest').write_text(f'#!/bin/sh\nexec {sys.executable} -m pytest "$@"\n')
    for name in ('pfd', 'pytest'):
        (site / name).chmod(0o755)
    env = environment(processes.domain)
    env |= {
        'PATH': f'{site}:{os.environ["PATH"]}',
        'PYTHONPATH': f'{site}:{env["PYTHONPATH"]}',
        'PYTEST_ADDOPTS': '-p no:cacheprovider',
    }
    outputs = {}
    for name, body in MINUTES_COMMANDS:
        if name == 'terminal 1':
            arm = processes.python('-m', 'pfd_ros.cli.main', *shlex.split(body)[1:])
        elif name == 'terminal 2':
            controller = processes.python(*shlex.split(body)[1:])
            wait_for_commands(folder / 'run.mcap')
            controller.stop()
            arm.stop()
        elif name != 'setup':
            done = subprocess.run(
                ['bash', '-ec', body],
                cwd=folder,
                env=env,
                capture_output=True,
                text=True,
                timeout=PATIENCE,
                check=False,
            )
            assert (done.returncode == 0) == (name != 'fails'), done.stdout + done.stderr
            outputs[body.splitlines()[-1]] = done.stdout
    assert (folder / 'pfd_demo' / 'arm_0.html').exists()
    assert (folder / 'run.html').exists()
    assert '1 passed' in outputs['pytest test_law.py']
    loaded = outputs['pytest test_loaded.py']
    assert 'shoulder: rests' in loaded
    assert re.search(r'^page +/', loaded, re.MULTILINE)
    assert 'every bit equal' in outputs['pfd report log run.mcap']
    assert '8 passed' in outputs['pytest']


def wait_for_commands(recording: Path) -> None:
    """Return once the arm has recorded commands."""

    def recorded() -> bool:
        # The file may be empty, or without its channels, so far.
        begun = recording.exists() and recording.stat().st_size > 0
        log = read_log(recording) if begun else {}
        return '/joint_commands' in log and len(log['/joint_commands']) >= 100

    wait_until(recorded, pause=0.5)


# The site.

# A separate network, in which not even the loopback is up.
ALONE = (shutil.which('unshare') or 'false', '--net')
# It ends soon, and without looking for garbage it is a seventh faster.
SPHINX = 'import gc, sys; gc.disable(); from sphinx.cmd.build import main; sys.exit(main())'


@pytest.fixture(scope='module')
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the site, built by the command of the page about the installation."""
    page = (ROOT / 'docs' / 'install.md').read_text(encoding='utf-8')
    (command,) = re.findall(r'&& (sphinx-build .*)$', page, re.MULTILINE)
    _, *options, source, name = shlex.split(command)
    assert '-W' in options
    folder = tmp_path_factory.mktemp('built') / name
    alone = ALONE if not subprocess.run([*ALONE, 'true'], check=False).returncode else ()
    done = subprocess.run(
        [*alone, sys.executable, '-c', SPHINX, '-q', *options, source, str(folder)],
        cwd=ROOT,
        env={**os.environ, 'PYTHONDONTWRITEBYTECODE': '1'},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.ros
def test_every_page_has_its_page_and_nothing_is_loaded_from_elsewhere(built):
    for page in (ROOT / 'docs').rglob('*.md'):
        assert (built / page.relative_to(ROOT / 'docs')).with_suffix('.html').exists(), page
    pages = list(built.rglob('*.html'))
    loading = re.compile(r'<(?:script|img|link|iframe)\b[^>]*?\b(?:src|href)="([^"]*)"')
    for page in pages:
        for target in loading.findall(page.read_text(encoding='utf-8')):
            assert not urlsplit(target).scheme, (page, target)
    for style in built.rglob('*.css'):
        found = re.findall(r'url\(["\']?(\w+:|//)', style.read_text(encoding='utf-8'))
        assert set(found) <= {'data:'}, style


@pytest.mark.ros
def test_the_reference_has_all_public_names(built):
    page = (built / 'reference' / 'pfd_core.html').read_text(encoding='utf-8')
    for name in set(pfd.__all__) - {'__version__'}:
        # A separate object, or a row of the table of constants.
        assert f'id="pfd_core.{name}"' in page or f'>{name}</span>' in page, name


@pytest.mark.ros
@needs_browser
def test_home_and_search_open_from_the_disk_without_errors(built, browser):
    with browser.shows((built / 'index.html').as_uri()) as page:

        def text():
            return str(page.value('document.body.innerText'))

        wait_until(lambda: 'Test torque controllers without a robot' in text(), text)
        search = (built / 'search.html').as_uri()
        page.call('Page.navigate', url=f'{search}?q=payload')
        links = "JSON.stringify([...document.querySelectorAll('.search li a')].map((a) => a.href))"
        wait_until(lambda: 'reference/quantities' in str(page.value(links)), text)
        wait_until(lambda: 'reference/pfd_core' in str(page.value(links)), text)
        page.call('Page.navigate', url=f'{search}?q=zygomorphic')
        wait_until(lambda: 'did not match any documents' in text(), text)


# Friction, payload and push move a joint off its motion by some hundredths of a radian.
VISIBLE, LIMIT = 1e-3, 0.1


@pytest.mark.parametrize('name', pfd.known_robots())
@pytest.mark.parametrize('seconds', [0.5, 5.0, 20.0])
def test_the_motion_starts_and_ends_at_rest_and_stays_within_the_limits(seconds, name):
    robot = pfd.load_robot(name)
    motion = scenario.motion_of(robot, seconds)
    for t in (0.0, seconds, 2 * seconds):
        # The sine of multiples of pi is rounded, below 1e-13 for tens of them.
        q, qd, qdd = motion.at(t)
        np.testing.assert_allclose(q, motion.start, rtol=0, atol=1e-15)
        np.testing.assert_allclose(qd, 0.0, rtol=0, atol=1e-15)
        np.testing.assert_allclose(qdd, 0.0, rtol=0, atol=1e-11)
    q = motion.at(np.linspace(0, seconds, 20001))[0]
    assert (q >= robot.position_lower).all()
    assert (q <= robot.position_upper).all()
    assert (np.ptp(q, axis=0) > 0).all()


def test_the_motion_has_the_derivatives_it_states():
    motion, step = scenario.motion_of(pfd.load_robot('puma560'), 5.0), 1e-5
    t = np.linspace(0.1, 4.9, 50)
    (q0, v0, _), (_, v, a), (q1, v1, _) = (motion.at(t + k * step) for k in (-1, 0, 1))
    # Differences err by step^2 / 6 times a derivative of third or fourth order, below 1000 here.
    for low, high, rate in ((q0, q1, v), (v0, v1, a)):
        np.testing.assert_allclose((high - low) / (2 * step), rate, rtol=0, atol=step**2 / 6e-3)


@pytest.mark.parametrize('name', one_fast(pfd.known_robots(), 'planar2'))
def test_the_disturbances_are_visible_and_the_controller_rejects_them(name):
    robot, seconds, push = pfd.load_robot(name), 2.0, 0.5
    motion = scenario.motion_of(robot, seconds)
    parameters = scenario.parameters(robot, seconds)
    settings = {key.replace('.', '_'): value for key, value in parameters.items()}
    settings = {k: tuple(v) if isinstance(v, list) else v for k, v in settings.items()}
    engine = made(robot=name, **{**settings, 'outputs': ()})
    cycles = round(seconds / 1e-3)
    off, messages = np.zeros(cycles), [commanded(*np.zeros(robot.n))]
    for k in range(cycles):
        (data,) = (m.data for m in engine.step(messages)[0] if m.role == 'joint_states')
        state, t = decode_joints(data), (k + 1) * 1e-3
        q, qd = np.array(state.position), np.array(state.velocity)
        off[k] = np.abs(q - motion.at(t)[0]).max()
        messages = [commanded(*scenario.efforts(robot, motion, t, q, qd))]
        if k == round(push * cycles):
            messages.append(wrench(robot.tip, scenario.push_force(robot)))
    before, after = off[: round(push * cycles)], off[round(push * cycles) :]
    assert VISIBLE < before.max() < LIMIT
    assert VISIBLE < after.max() < LIMIT


@pytest.mark.parametrize(
    ('periods', 'slow'),
    [(50 * [0.5, 1.5], False), (100 * [1.005], False), (99 * [1.0] + [10.0], True)],
)
def test_a_rate_below_the_one_of_the_stamps_is_a_machine_that_is_too_slow(periods, slow, capsys):
    # States at 1 kHz, by the times [ms] between their messages.
    stamps = np.arange(len(periods) + 1) * 1_000_000
    times = np.cumsum([0, *(round(1e6 * period) for period in periods)])
    log = {'/states': SimpleNamespace(stamp_ns=stamps, log_ns=times)}
    assert run._rate(log, '/states') == slow
    printed = capsys.readouterr().out
    assert 'of 1000 Hz' in printed
    assert ('this machine is too slow' in printed) == slow


@pytest.mark.ros
def test_even_on_one_domain_two_demos_are_apart(tmp_path, monkeypatch):
    # A domain that looked free to both: their names and clocks still differ.
    started: list[list[str]] = []
    monkeypatch.setattr(
        'pfd_ros.demo.run.ChildProcess', lambda command, *_: started.append(command)
    )
    for _ in range(2):
        with suppress(AttributeError):
            run.run_demo('planar2', 1.0, tmp_path)
    names = [[part for part in command if part.startswith('__ns:=')] for command in started]
    assert len(names) >= 2
    assert all(len(name) == 1 for name in names)
    assert len({name[0] for name in names}) == 2
    assert all('/clock:=clock' in command for command in started)


# Variables that lead to other systems.
HOSTILE = {
    'ROS_LOCALHOST_ONLY': '0',
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET',
    'ROS_STATIC_PEERS': '127.0.0.1;192.0.2.1',
    'ROS_DISCOVERY_SERVER': '127.0.0.1:11811',
    'ROS_SUPER_CLIENT': 'TRUE',
    'ROS_SECURITY_ENABLE': 'true',
    'ROS_SECURITY_STRATEGY': 'Enforce',
    'FASTRTPS_DEFAULT_PROFILES_FILE': '/nowhere/profiles.xml',
    'FASTDDS_DEFAULT_PROFILES_FILE': '/nowhere/profiles.xml',
    'RMW_FASTRTPS_USE_QOS_FROM_XML': '1',
    'CYCLONEDDS_URI': '<CycloneDDS/>',
    'ZENOH_ROUTER_CONFIG_URI': '/nowhere',
}


def start_demo(folder: Path, domain: int) -> subprocess.Popen[str]:
    command = ['-m', 'pfd_ros.cli.main', 'demo', '--seconds', '1', '--out', 'here']
    return subprocess.Popen(
        [sys.executable, *command],
        cwd=folder,
        env=environment(domain) | HOSTILE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def check_demo(folder: Path, process: subprocess.Popen[str]) -> str:
    printed = process.communicate(timeout=3 * PATIENCE)[0]
    # On a busy machine commands may be lost, periods missed and the motion left, and nothing else.
    failures = re.findall('FAILED: (.*)', printed)
    assert all(failure.startswith('the arm was') for failure in failures), printed
    assert process.returncode == (1 if failures else 0), printed
    base = folder / 'here' / 'arm_0'
    assert re.search(r'replay +\d+ cycles simulated again: every bit equal', printed)
    assert re.search(r'rate +[\d.]+ Hz of 1000 Hz', printed)
    assert re.search(r'^ +[\d.]+ s: 1 s of motion, at rest before and after it$', printed, re.M)
    assert '<html' in base.with_suffix('.html').read_text(encoding='utf-8')
    assert verify_log(base.with_suffix('.mcap')).complete
    # The terminal and the page have one line on each joint.
    lines = re.findall(r'^(?:tracking)? +(joint\d: .*)$', printed, re.MULTILINE)
    shown = base.with_suffix('.html').read_text(encoding='utf-8')
    assert lines == re.findall('<li>(joint.*?)</li>', shown)
    assert len(lines) == 6
    if not failures:
        assert all(' rad, farthest at t = ' in line for line in lines)
        assert re.search('^page +here/arm_0.html: nothing went wrong', printed, re.MULTILINE)
        assert printed.endswith('everything worked\n')
    return printed


@pytest.mark.slow
def test_the_demo_verifies_itself_and_sends_nothing_to_a_live_arm(processes, peer_of, tmp_path):
    from sensor_msgs.msg import JointState

    (tmp_path / 'DEFAULT_FASTRTPS_PROFILES.xml').write_text('<no profile')
    # An arm on the domain, and by the names, that the demo's environment would lead to.
    peer = peer_of(processes)
    commands: list[Any] = []
    seen: set[str] = set()
    peer.node.create_subscription(JointState, '/joint_commands', commands.append, 10)
    process = start_demo(tmp_path, processes.domain)
    try:
        while process.poll() is None:
            peer.executor.spin_once(timeout_sec=0.05)
            seen |= set(peer.node.get_node_names())
        check_demo(tmp_path, process)
    finally:
        process.kill()
    assert commands == peer.states == peer.clocks == []
    assert seen == {'peer'}
    printed = (tmp_path / 'here' / 'arm_0.sim_arm.txt').read_text()
    assert re.search(r'subscribed to /pfd_demo_[0-9a-f]{8}/joint_commands', printed)
    log = read_log(tmp_path / 'here' / 'arm_0.mcap')
    assert all(
        topic.startswith('/pfd_demo_') for topic, role in log.roles.items() if role == 'clock'
    )


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.long
def test_the_demo_shows_the_arm_while_it_runs(tmp_path, monkeypatch, capsys):
    # Nobody opens the page.
    monkeypatch.setattr('pfd_ros.demo.run.PAGE_SECONDS', 0.5)
    assert run.run_demo('planar2', 1.0, tmp_path, 0) == 0, capsys.readouterr()
    printed = capsys.readouterr().out
    assert re.search(
        r'^view +http://127\.0\.0\.1:\d+: the arm starts when a browser', printed, re.MULTILINE
    )
    seen = (tmp_path / 'arm_0.view.txt').read_text()
    assert re.search(r'^receiving /pfd_demo_[0-9a-f]{8}/joint_states$', seen, re.MULTILINE)
    assert 'Traceback' not in seen
