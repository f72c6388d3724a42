# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The first finding of a log as a pytest: it fails today by its finding, and passes once fixed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import subprocess
import sys
from typing import Any

from arm_messages import named
import numpy as np
import pytest
from recordings import simulate
from test_cli import command
from test_page import FAULTS, TIMES, UR5, states, write_bag

from pfd_ros.motion.symptoms import KINDS as SYMPTOM_KINDS
from pfd_ros.page.findings import KINDS as FINDING_KINDS
from pfd_ros.testing import ArmError, LockstepArm, findings, recorded, replayed
from pfd_ros.testing.written import ASSERTIONS as FINDING_ASSERTIONS

ARM: dict[str, Any] = {'robot': 'planar2', 'gravity_compensation': True}
LAW = """
import numpy as np

GOAL = np.array([0.4, -0.3])
DAMPING = {damping}


def law(t, q, qd):
    return {stiffness} * (GOAL - q) - DAMPING * qd + {wave} * np.sin(60.0 * t)


class Holder:
    law = staticmethod(law)


holder = Holder()
"""
FIXED = LAW.format(damping=8.0, stiffness=20.0, wave=0.0)
# Wrong law -> kind of the first finding and its joint.
WRONG = {
    'the sign of its damping': (
        LAW.format(damping=-3.0, stiffness=20.0, wave=0.0),
        *('effort limit', 'elbow'),
    ),
    'saturates': (LAW.format(damping=1.0, stiffness=900.0, wave=0.0), 'effort limit', 'shoulder'),
    'a limit cycle': (
        LAW.format(damping=8.0, stiffness=20.0, wave=4.0),
        'oscillation',
        'shoulder',
    ),
}


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, 'path', [*sys.path])


def passes(file: str) -> bool:
    # From another folder, and without the current one on the path of Python.
    pytest_itself = Path(sys.executable).with_name('pytest')
    done = subprocess.run(
        [pytest_itself, '-q', '-p', 'no:cacheprovider', Path(file).resolve()],
        cwd='/',
        capture_output=True,
        text=True,
        check=False,
        env={'PATH': '/usr/bin:/bin', 'PYTHONDONTWRITEBYTECODE': '1'},
    )
    assert done.returncode in (0, 1), done.stdout
    return done.returncode == 0


def upright(path: Path) -> None:
    """Record a servo that is too weak to hold its arm upright."""
    servo = {
        'servo_p': (1.0, 1.0),
        'servo_d': (0.1, 0.1),
        'initial_positions': (np.pi / 2 + 0.02, 0.0),
    }
    events = {1: [named(['shoulder', 'elbow'], position=[np.pi / 2, 0.0])]}
    simulate(path, 600, events, **servo)


def pushed(torque: float) -> Callable[[Path], Any]:
    """Return what records a constant torque while the reference of the shoulder rises."""
    events = {
        k: [named(['shoulder'], effort=[torque], position=[0.001 * k])] for k in range(1, 300, 10)
    }
    return lambda path: simulate(path, 300, events, gravity=(0.0, 0.0, 0.0))


def fault(name: str) -> Callable[[Path], Any]:
    events, cycles, given, _, _, _ = FAULTS[name]
    return lambda path: simulate(path, cycles, events, **given)


def infinite(path: Path) -> None:
    rows = states(UR5, TIMES)
    rows[50][2]['velocity'][2] = np.inf
    write_bag(path, rows)


def silent(path: Path) -> None:
    write_bag(path, states(UR5, [t for k, t in enumerate(TIMES) if not 40 <= k < 60]))


REPLAYED = 'motion = replayed(LOG, run)'
# Log -> its first finding, the assertion, and other words of the test.
WRITTEN: dict[str, tuple[Callable[[Path], Any], str, str, str]] = {
    **{
        name: (fault(name), FAULTS[name][4], assertion, REPLAYED)
        for name, assertion in (
            ('effort at its limit', "motion.assert_no_limit_hit('effort', joint='shoulder')"),
            ('too fast', "motion.assert_no_limit_hit('velocity', joint='elbow')"),
            ('wrong size', "assert findings(run, 'rejected input', '') == []"),
            ('silence', "assert findings(run, 'watchdog', '') == []"),
            ('jump of an effort', "assert findings(run, 'reflex', '') == []"),
            ('run away', 'assert not motion.stopped'),
        )
    },
    'never commanded': (
        lambda path: simulate(path, 100, {5: [named(['elbow'], effort=(0.1,))]}),
        'never commanded',
        *("assert motion.commanded[motion.index('shoulder')]", REPLAYED),
    ),
    'falls': (upright, 'divergence', "findings(run, 'divergence', 'shoulder') == []", REPLAYED),
    'wrong way': (pushed(-1.0), 'driven away', "(run, 'driven away', 'shoulder') == []", REPLAYED),
    'too little': (pushed(0.0), 'lost', "findings(run, 'lost', 'shoulder') == []", REPLAYED),
    # Logs of other arms.
    'infinite': (infinite, 'not finite', "(run, 'not finite', 'elbow_joint') == []", 'run = LOG'),
    'silent': (silent, 'gap', "assert findings(run, 'gap', '') == []", 'run = LOG'),
}


@pytest.mark.parametrize('name', WRITTEN)
def test_the_first_finding_is_written_as_a_test_that_fails_by_it(name: str) -> None:
    record, kind, assertion, words = WRITTEN[name]
    Path('logs').mkdir()
    Path('tests').mkdir()
    record(Path('logs/a.mcap'))
    status, printed, error = command('report', 'log', 'logs/a.mcap', '--pytest', 'tests/test_a.py')
    assert (status, error) == (0, '')
    assert f', {kind}: ' in printed
    assert 'tests/test_a.py fails today: ' in printed
    text = Path('tests/test_a.py').read_text()
    assert assertion in text
    assert words in text
    assert "LOG = HERE / '../logs/a.mcap'" in text
    # No page is written beside it, unless it is named.
    assert {*Path().iterdir()} == {Path('logs'), Path('tests')}


def test_the_limits_of_another_arm_are_those_of_the_robot_that_is_named() -> None:
    rows = states(UR5, TIMES)
    rows[70][2]['velocity'][2] = 4.0
    write_bag(Path('a.mcap'), rows)
    assert command('report', 'log', 'a.mcap', '--pytest', 'test_a.py')[0] == 1
    words = [
        'report',
        'log',
        'a.mcap',
        '--robot',
        'ur5',
        '--pytest',
        'test_a.py',
        '--out',
        'a.html',
    ]
    status, printed, _ = command(*words)
    assert (status, 'elbow_joint' in printed, Path('a.html').exists()) == (0, True, True)
    text = Path('test_a.py').read_text()
    assert "recorded(LOG, 'elbow_joint', robot='ur5')" in text
    # Recorded again, it passes.
    Path('a.mcap').unlink()
    write_bag(Path('a.mcap'), states(UR5, TIMES))
    assert passes('test_a.py')


@pytest.mark.parametrize('name', WRONG)
def test_with_its_controller_the_test_passes_once_that_is_fixed(name: str) -> None:
    text, kind, joint = WRONG[name]
    # A name of the template too.
    attribute, more = 'holder.law' if name == 'saturates' else 'run', '\n\nrun = law\n'
    Path('wrong.py').write_text(text + more)
    Path('tests').mkdir()
    found: dict[str, Any] = {}
    exec(text, found)
    with LockstepArm(**ARM, recording='a.mcap') as arm:
        try:
            arm.run(found['law'], 2.0)
        except ArmError:
            assert 'sign' in name
    words = ['--pytest', 'tests/test_a.py', '--controller', f'wrong:{attribute}']
    status, printed, error = command('report', 'log', 'a.mcap', *words)
    assert (status, error) == (0, '')
    assert f', {kind}: {joint}: ' in printed
    assert not passes('tests/test_a.py')
    Path('wrong.py').write_text(FIXED + more)
    assert passes('tests/test_a.py')


def test_with_a_controller_that_lacks_the_fault_nothing_is_written() -> None:
    fault('effort at its limit')(Path('a.mcap'))
    Path('wrong.py').write_text(FIXED)
    words = ['--pytest', 'test_a.py', '--controller', 'wrong:law']
    status, printed, error = command('report', 'log', 'a.mcap', *words)
    assert (status, printed) == (1, '')
    assert 'test_a.py is not written' in error
    assert 'does not fail by it: it passes; without --controller' in error
    assert not Path('test_a.py').exists()


def test_every_kind_of_finding_has_an_assertion_or_says_why_not() -> None:
    assert {*FINDING_ASSERTIONS} == {*FINDING_KINDS, *SYMPTOM_KINDS}
    for kind, row in FINDING_ASSERTIONS.items():
        assert bool(row.code) != bool(row.why), kind
    tested = {kind for _, kind, _, _ in WRITTEN.values()} | {kind for _, kind, _ in WRONG.values()}
    # A limit of positions is as that of velocities; diagnostics are as other logs' gaps.
    asserted = {kind for kind, row in FINDING_ASSERTIONS.items() if row.code}
    assert asserted - tested == {'position limit', 'diagnostics'}


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        ('good.mcap --pytest test_a.py', 'good.mcap: nothing went wrong, so there is no finding'),
        ('bad.mcap --pytest a.py', "pytest collects test_*.py, got the name 'a.py'"),
        ('bad.mcap --pytest test_mine.py', 'test_mine.py exists and is not overwritten; name'),
        ('bad.mcap --pytest no/test_a.py', 'no/test_a.py: No such file or directory'),
        ('bad.mcap --pytest test_a.py --controller wrong', 'must be module:function'),
        ('bad.mcap --pytest test_a.py --controller wrong:raises', 'KeyError'),
        (
            'other.mcap --pytest test_a.py --controller wrong:law',
            '--controller: no simulation of other.mcap shows',
        ),
        ('bad.mcap --controller wrong:law', '--controller requires --pytest'),
        ('bad.mcap --pytest test_a.py --start 0.01', '--pytest conflicts with --start'),
    ],
)
def test_what_cannot_be_written_is_one_line_and_no_file(words: str, message: str) -> None:
    simulate(
        Path('good.mcap'), 50, {k: [named(['shoulder', 'elbow'], effort=[0, 0])] for k in (1, 2)}
    )
    fault('effort at its limit')(Path('bad.mcap'))
    infinite(Path('other.mcap'))
    Path('test_mine.py').write_text('mine')
    Path('wrong.py').write_text(f"{FIXED}\n\ndef raises(t, q, qd):\n    return {{}}['gain']\n")
    before = {*Path().iterdir()}
    status, _, error = command('report', 'log', *words.split())
    assert status == (2 if message.startswith('--') and 'shows' not in message else 1)
    assert message in error
    assert len(error.splitlines()) == 1
    assert {*Path().iterdir()} - {Path('__pycache__')} == before
    assert Path('test_mine.py').read_text() == 'mine'


def test_names_in_a_log_cannot_write_other_code() -> None:
    hostile = 'elbow\'); raise SystemExit(3) #\n\u2028"""\\{joint}'
    rows = states([hostile, 'other'], TIMES)
    rows[50][2]['velocity'][0] = np.inf
    write_bag(Path('a.mcap'), rows)
    status, printed, _ = command('report', 'log', 'a.mcap', '--pytest', 'test_a.py')
    assert status == 0
    assert 'fails today: AssertionError: ' in printed
    assert len(Path('test_a.py').read_text().splitlines()) < 20


def test_a_replayed_motion_is_that_of_the_log_or_of_a_changed_arm() -> None:
    found: dict[str, Any] = {}
    exec(FIXED, found)
    with LockstepArm(**ARM, recording='a.mcap') as arm:
        motion = arm.run(found['law'], 0.5)
    for given in ({}, {'controller': found['law']}):
        again = replayed('a.mcap', Path(f'{len(given)}.mcap'), **given)
        assert again.names == motion.names
        assert again.stopped == ''
        # The first row of a test is the state before the first step.
        np.testing.assert_array_equal(again.q[:-1], motion.q[1:])
        np.testing.assert_array_equal(again.tau, motion.tau)
        np.testing.assert_array_equal(again.limits.effort, motion.limits.effort)
        assert again.tip() == pytest.approx(recorded('a.mcap').tip())
    other = replayed('a.mcap', 'b.mcap', ['payload.mass=1.5'], controller=found['law'])
    assert np.abs(other.q - again.q).max() > 1e-3
    assert findings('a.mcap', 'effort limit', 'shoulder') == []
