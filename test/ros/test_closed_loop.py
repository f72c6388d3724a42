# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Logs run again with a controller in the loop, and their first finding written as a pytest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
import re
import runpy
import shlex
import shutil
import sys
import tempfile
from types import SimpleNamespace
from typing import Any

from arm_messages import efforts, named
import numpy as np
import pytest
from recordings import Run, simulate
from ros_processes import PATIENCE
from test_cli import command
from test_page import FAULTS as PAGE_FAULTS
from test_page import TIMES, UR5, states, write_bag
from tested_controllers import node_of

from pfd_ros.motion.symptoms import KINDS as SYMPTOM_KINDS
from pfd_ros.page.findings import KINDS as FINDING_KINDS
from pfd_ros.recording.format import LogError
from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.replay.verify import verify as verify_log
from pfd_ros.testing import ArmError, LockstepArm, findings, recorded, replayed
from pfd_ros.testing.written import ASSERTIONS as FINDING_ASSERTIONS

CONTROLLERS = Path(__file__).with_name('tested_controllers.py')
LAWS = """
import numpy as np

GOAL = np.array([0.4, -0.3])
seen = []


def pd(t, q, qd):
    return 30.0 * (GOAL - q) - 3.0 * qd + np.sin(50.0 * t)


class Integral:
    total = np.zeros(2)

    def law(self, t, q, qd):
        self.total = self.total + (GOAL - q)
        return pd(t, q, qd) + 0.01 * self.total


integral = Integral()


def raises(t, q, qd):
    return {'gains': pd(t, q, qd)}['gain'] if t > 0.05 else pd(t, q, qd)


def nan(t, q, qd):
    return pd(t, q, qd) + (np.nan if t > 0.05 else 0.0)


def short(t, q, qd):
    return pd(t, q, qd)[:1] if t > 0.05 else pd(t, q, qd)


def ends(t, q, qd):
    return pd(t, q, qd) if t < 0.05 else None


def never(t, q, qd):
    raise RuntimeError('not today')
"""
ARM = {'robot': 'planar2', 'gravity_compensation': True, 'external_wrench': True}


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, 'path', [*sys.path])


def defined(code: str) -> dict[str, Any]:
    """Return the names that code defines."""
    found: dict[str, Any] = {}
    exec(code, found)
    return found


@pytest.fixture
def laws(here: None) -> dict[str, Any]:
    """Write the controllers into the current folder, and return them."""
    Path('laws.py').write_text(LAWS)
    return defined(LAWS)


@pytest.fixture(scope='module')
def log_of_pd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of the first law."""
    path = tmp_path_factory.mktemp('pd') / 'a.mcap'
    driven(str(path), defined(LAWS)['pd'])
    return path


@pytest.fixture
def driven_by_pd(laws: dict[str, Any], log_of_pd: Path) -> None:
    """Put the laws and a recording of the first one into the current folder."""
    shutil.copy(log_of_pd, 'a.mcap')


def states_of(path: Path | str) -> list[bytes]:
    return [m.data for m in RecordedLog(path).messages() if m.role == 'joint_states']


def driven(path: str, law: Callable[..., Any], **settings: Any) -> None:
    """Record a test that pushes, changes, sets and resets its arm between runs."""
    with LockstepArm(**ARM, **settings, recording=path) as arm:
        arm.run(law, 0.06)
        arm.push([5.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        arm.run(law, 0.06)
        arm.set_state([0.1, 0.2])
        arm.set(payload_mass=0.5)
        arm.run(law, 0.06)
        arm.reset()
        arm.run(law, 0.06)


def awaited(path: str, law: Callable[..., Any]) -> None:
    """Record an arm in lockstep whose controller comes after 20 states."""
    run = Run(Path(path), lockstep=True)
    run.step(times=20)
    for _ in range(200):
        q, qd, _ = run.engine.measured()
        run.step(efforts(*law(run.engine.stamp_ns * 1e-9, q.copy(), qd.copy())))
    run.close()


def constant(t: float, q: Any, qd: Any) -> Any:
    return 20.0 * (0.3 - q) - 2.0 * qd


RECORDED: dict[str, Callable[[str, dict[str, Any]], None]] = {
    'each step': lambda path, laws: driven(path, laws['pd']),
    '250 Hz, noise, delays, losses': lambda path, laws: driven(
        path,
        laws['pd'],
        publish_rate=250.0,
        noise_velocity=0.01,
        delay_state=0.003,
        delay_commands=0.002,
        drop_commands=0.1,
    ),
    'lost states': lambda path, laws: driven(path, laws['pd'], drop_state=0.2),
    'a controller with a state': lambda path, laws: driven(path, laws['integral'].law),
}


@pytest.mark.parametrize('kind', RECORDED)
def test_the_law_that_made_a_log_in_lockstep_has_its_bits(kind, laws):
    RECORDED[kind]('a.mcap', laws)
    law = 'integral.law' if 'state' in kind.split()[-1:] else 'pd'
    status, printed, error = command(
        *f'replay a.mcap --what-if --controller laws:{law} --rounding'.split()
    )
    assert (status, error) == (0, '')
    assert re.search(
        rf'loop +closed: laws:{law} in lockstep, (\d+) commands; the log has \1,', printed
    )
    assert len(states_of('a.mcap')) > 50
    assert states_of('a_what_if.mcap') == states_of('a.mcap')
    assert verify_log('a_what_if.mcap').complete
    rows = [line for line in printed.splitlines() if line.startswith(('position', 'velocity'))]
    assert len(rows) == 4
    # Also a controller with a state begins anew in the rounding run.
    assert all('equal' in line and line.endswith('never') for line in rows)


def test_a_controller_begins_where_the_recorded_one_did():
    awaited('a.mcap', constant)
    text = 'def law(t, q, qd):\n    return 20.0 * (0.3 - q) - 2.0 * qd\n'
    Path('others.py').write_text(text)
    words = ['replay', 'a.mcap', '--what-if', '--controller', 'others:law']
    assert command(*words)[0] == 0
    assert len(states_of('a.mcap')) == 220
    assert states_of('a_what_if.mcap') == states_of('a.mcap')


@pytest.mark.parametrize(
    'words', [['payload.mass=0.8'], ['noise.velocity=0.02', 'seed=4'], ['step_size=0.0005']]
)
def test_the_changed_arm_moves_as_one_that_was_so_from_the_start(words, laws):
    settings = {x.partition('=')[0].replace('.', '_'): float(x.partition('=')[2]) for x in words}
    settings |= {'seed': int(settings['seed'])} if 'seed' in settings else {}

    def record(path, **more):
        with LockstepArm(**{**ARM, 'start_time': 1.0, **more}, recording=path) as arm:
            arm.run(laws['pd'], 0.05)
            arm.push([5.0, 0.0, 0.0], [0.0, 1.0, 0.0])
            arm.run(laws['pd'], 0.05)

    record('a.mcap')
    record('b.mcap', **settings)
    status, printed, _ = command(
        'replay', 'a.mcap', '--what-if', *words, '--controller', 'laws:pd'
    )
    assert status == 0
    assert states_of('a_what_if.mcap') == states_of('b.mcap')
    # Without it the recorded torques act, and a line says so.
    status, printed, _ = command('replay', 'a.mcap', '--what-if', *words)
    assert re.search('loop +open: recorded torques', printed)
    assert states_of('a_what_if_2.mcap') != states_of('b.mcap')


# Controller -> in the line FAILED, and in the error output.
FAULTS = {
    'raises': (
        '0.050000 s, compared up to there: the controller raised at t = 0.051 s',
        'laws.py", line 2',
    ),
    'nan': ("returned nan for joint 'shoulder', nan for joint 'elbow'", 'expected finite efforts'),
    'short': ('the controller returned array', 'expected 2 numbers'),
    'ends': ('the controller returned None at t = 0.05 s', 'expected 2 numbers'),
    'never': (
        '0.000000 s, nothing is compared: the controller raised at t = 0.001 s',
        'not today',
    ),
}


@pytest.mark.parametrize('fault', FAULTS)
def test_a_controller_that_fails_is_named_and_its_run_is_recorded_up_to_there(fault, driven_by_pd):
    before = Path('a.mcap').read_bytes()
    # A plot of nothing is the special one.
    plot = ['--plot', 'a.svg'] if fault == 'never' else []
    words = ['replay', 'a.mcap', '--what-if', '--controller', f'laws:{fault}', *plot]
    status, printed, error = command(*words)
    assert status == 1
    (line,) = [line for line in printed.splitlines() if line.startswith('FAILED')]
    said, shown = FAULTS[fault]
    assert line.startswith('FAILED     controller stopped at ')
    assert said in line
    assert shown in error
    assert 'pfd_ros' not in error
    assert verify_log('a_what_if.mcap').complete
    count = 0 if fault == 'never' else 49
    # Where nothing was computed, no table says that nothing differs.
    assert ('nothing is compared' in line) == ('diverged' not in printed) == (fault == 'never')
    assert states_of('a_what_if.mcap')[:count] == states_of('a.mcap')[:count]
    assert len(states_of('a_what_if.mcap')) in (count, count + 1, count + 2)
    assert Path('a.mcap').read_bytes() == before


@pytest.mark.parametrize(
    ('words', 'status', 'message'),
    [
        ('--what-if --controller laws', 1, "must be module:function or a process, got 'laws'"),
        ('--what-if --controller laws:', 1, 'must be module:function'),
        ('--what-if --controller laws:pid', 1, "module 'laws' has no attribute 'pid'"),
        ('--what-if --controller laws:GOAL', 1, r'is array\(.* expected a function'),
        (
            '--what-if --controller laws:Integral',
            1,
            "is <class 'laws.Integral'>, expected a function",
        ),
        ('--what-if --controller lows:pd', 1, "ModuleNotFoundError: .*'lows'"),
        ('--what-if --controller wrong:pd', 1, 'SyntaxError: .*line 1'),
        ('--what-if --controller laws:pd --process x', 1, 'give one of them'),
        ('--what-if --process=', 1, "must be module:function or a process, got ''"),
        ('--what-if --process "x', 1, 'No closing quotation'),
        ('--controller laws:pd', 2, '--controller requires --what-if'),
        ('--verify --process x', 2, '--process requires --what-if'),
    ],
)
def test_what_is_no_controller_is_one_line_and_writes_nothing(
    words, status, message, driven_by_pd
):
    Path('wrong.py').write_text('def (')
    given = words.split() if '"' in words else shlex.split(words)
    found = command('replay', 'a.mcap', *given)
    assert found[0] == status
    assert re.search(message, found[2])
    assert len(found[2].splitlines()) == 1
    assert not Path('a_what_if.mcap').exists()


# Kind of node, fault -> status, the line FAILED, and the cycles before the node began.
NODES = {
    ('timer', ''): (0, '', 0),
    ('states', 'dies'): (1, 'ended by SIGSEGV at t = 0.031 s, after 20 answers', 10),
    ('states', 'nan'): (1, "not_finite: effort of joint 'elbow_joint' is nan", 10),
}


@pytest.mark.parametrize(('kind', 'fault'), NODES)
def test_an_unchanged_node_in_another_process_begins_as_it_did_and_has_the_bits_of_its_log(
    kind, fault, ros_domain, monkeypatch
):
    status, said, idle = NODES[kind, fault]
    for name in ('PATIENCE_SECONDS', 'START_PATIENCE_SECONDS'):
        monkeypatch.setattr(f'pfd_ros.testing.again.{name}', PATIENCE)
    node = node_of(kind)
    with LockstepArm('ur5', armature=True, recording='a.mcap') as arm:
        while arm.engine.state.cycle < idle:
            arm.step()
        arm.spin(0.1, node)
    node.destroy_node()
    words = shlex.join([sys.executable, str(CONTROLLERS), kind, *filter(None, [fault])])
    found = command('replay', 'a.mcap', '--what-if', '--process', words)
    assert found[0] == status, found
    assert said in found[1] if said else 'FAILED' not in found[1]
    assert verify_log('a_what_if.mcap').complete
    new, old = states_of('a_what_if.mcap'), states_of('a.mcap')
    assert len(old) == idle + 100
    assert len(new) == idle + (21 if fault == 'nan' else 20 if fault else 100)
    assert new[: idle + 20] == old[: idle + 20]
    assert fault or new == old


def test_a_simulation_that_fails_ends_the_run_with_its_time_and_status_0(driven_by_pd):
    words = ['damping=[1e6, 1e6]', 'integrator=rk4', '--controller', 'laws:pd']
    status, printed, _ = command('replay', 'a.mcap', '--what-if', *words)
    assert status == 0
    assert 'FAILED     simulation stopped at 0.0' in printed
    assert verify_log('a_what_if.mcap').complete


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


def run_here(command: Sequence[Any], **_: Any) -> SimpleNamespace:
    """Do what a process with pytest does with a file of one test, in this process.

    It runs in another folder than the current one, and without it on the path of Python.
    """
    file, modules, here = Path(command[-1]).absolute(), {*sys.modules}, Path.cwd()
    with pytest.MonkeyPatch.context() as patch, tempfile.TemporaryDirectory() as folder:
        patch.chdir('/')
        patch.setattr(sys, 'path', [x for x in sys.path if Path(x or here) != here])
        # A controller is written twice within a second.
        patch.setattr(sys, 'dont_write_bytecode', True)
        for name, module in [*sys.modules.items()]:
            if Path(getattr(module, '__file__', None) or '/').parent == here:
                patch.delitem(sys.modules, name)
        names = runpy.run_path(str(file))
        (test,) = (call for name, call in names.items() if name.startswith('test_'))
        printed = ''
        try:
            test(*[Path(folder)] * test.__code__.co_argcount)
        except Exception as error:
            printed = f'FAILED {file.name}::{test.__name__} - {type(error).__name__}: {error}'
        for name in {*sys.modules} - modules:
            del sys.modules[name]
    return SimpleNamespace(returncode=bool(printed), stdout=printed, stderr='')


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run written tests without processes."""
    own = SimpleNamespace(run=run_here, TimeoutExpired=TimeoutError)
    monkeypatch.setattr('pfd_ros.testing.written.subprocess', own)


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
    events, cycles, given, _, _, _ = PAGE_FAULTS[name]
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
        name: (fault(name), PAGE_FAULTS[name][4], assertion, REPLAYED)
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
def test_the_first_finding_is_written_as_a_test_that_fails_by_it(name, in_this_process):
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
    assert '\n\n\n\n' not in text
    assert "LOG = HERE / '../logs/a.mcap'" in text
    # No page is written beside it, unless it is named.
    assert {*Path().iterdir()} == {Path('logs'), Path('tests')}
    assert not command('report', 'log', 'logs/a.mcap')[1].startswith('nothing went wrong')


def test_the_limits_of_another_arm_are_those_of_the_robot_that_is_named(in_this_process):
    rows = states(UR5, TIMES)
    rows[70][2]['velocity'][2] = 4.0
    write_bag(Path('a.mcap'), rows)
    assert command('report', 'log', 'a.mcap', '--pytest', 'test_a.py')[0] == 1
    words = 'report log a.mcap --robot ur5 --pytest test_a.py --out a.html'
    status, printed, _ = command(*words.split())
    assert (status, 'elbow_joint' in printed, Path('a.html').exists()) == (0, True, True)
    text = Path('test_a.py').read_text()
    assert "recorded(LOG, 'elbow_joint', robot='ur5')" in text
    # Recorded again, it passes.
    Path('a.mcap').unlink()
    write_bag(Path('a.mcap'), states(UR5, TIMES))
    assert not run_here(['test_a.py']).returncode


@pytest.mark.parametrize('name', WRONG)
def test_with_its_controller_the_test_passes_once_that_is_fixed(name, request):
    text, kind, joint = WRONG[name]
    # One real process.
    if name != 'saturates':
        request.getfixturevalue('in_this_process')
    # A name of the template too.
    attribute, more = 'holder.law' if name == 'saturates' else 'run', '\n\nrun = law\n'
    Path('wrong.py').write_text(text + more)
    Path('tests').mkdir()
    with LockstepArm(**ARM, recording='a.mcap') as arm:
        try:
            arm.run(defined(text)['law'], 1.0 if 'cycle' in name else 0.3)
        except ArmError:
            assert 'sign' in name
    words = ['--pytest', 'tests/test_a.py', '--controller', f'wrong:{attribute}']
    status, printed, error = command('report', 'log', 'a.mcap', *words)
    assert (status, error) == (0, '')
    assert f', {kind}: {joint}: ' in printed
    assert run_here(['tests/test_a.py']).returncode
    Path('wrong.py').write_text(FIXED + more)
    assert not run_here(['tests/test_a.py']).returncode


def test_with_a_controller_that_lacks_the_fault_nothing_is_written():
    fault('effort at its limit')(Path('a.mcap'))
    Path('wrong.py').write_text(FIXED)
    words = ['--pytest', 'test_a.py', '--controller', 'wrong:law']
    status, printed, error = command('report', 'log', 'a.mcap', *words)
    assert (status, printed) == (1, '')
    assert 'test_a.py is not written' in error
    assert 'does not fail by it: it passes; without --controller' in error
    assert not Path('test_a.py').exists()


def test_every_kind_of_finding_has_an_assertion_or_says_why_not():
    assert {*FINDING_ASSERTIONS} == {*FINDING_KINDS, *SYMPTOM_KINDS}
    for kind, row in FINDING_ASSERTIONS.items():
        assert bool(row.code) != bool(row.why), kind
    tested = {kind for _, kind, _, _ in WRITTEN.values()} | {kind for _, kind, _ in WRONG.values()}
    # A limit of positions is as that of velocities; diagnostics are as other logs' gaps.
    asserted = {kind for kind, row in FINDING_ASSERTIONS.items() if row.code}
    assert asserted - tested == {'position limit', 'diagnostics'}


@pytest.fixture(scope='module')
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with logs without a fault, with one, and of another arm."""
    folder = tmp_path_factory.mktemp('logs')
    idle = {k: [named(['shoulder', 'elbow'], effort=[0, 0])] for k in (1, 2)}
    simulate(folder / 'good.mcap', 50, idle)
    fault('effort at its limit')(folder / 'bad.mcap')
    infinite(folder / 'other.mcap')
    return folder


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
def test_what_cannot_be_written_is_one_line_and_no_file(words, message, logs, in_this_process):
    for log in logs.iterdir():
        shutil.copy(log, log.name)
    Path('test_mine.py').write_text('mine')
    Path('wrong.py').write_text(f"{FIXED}\n\ndef raises(t, q, qd):\n    return {{}}['gain']\n")
    before = {*Path().iterdir()}
    status, _, error = command('report', 'log', *words.split())
    assert status == (2 if message.startswith('--') and 'shows' not in message else 1)
    assert message in error
    assert len(error.splitlines()) == 1
    assert {*Path().iterdir()} - {Path('__pycache__')} == before
    assert Path('test_mine.py').read_text() == 'mine'


def test_names_in_a_log_cannot_write_other_code(in_this_process):
    hostile = 'elbow\'); raise SystemExit(3) #\n\u2028"""\\{joint}'
    rows = states([hostile, 'other'], TIMES)
    rows[50][2]['velocity'][0] = np.inf
    write_bag(Path('a.mcap'), rows)
    status, printed, _ = command('report', 'log', 'a.mcap', '--pytest', 'test_a.py')
    assert status == 0
    assert 'fails today: AssertionError: ' in printed
    assert len(Path('test_a.py').read_text().splitlines()) < 20


def test_a_replayed_motion_is_that_of_the_log_or_of_a_changed_arm():
    law = defined(FIXED)['law']
    with LockstepArm(**ARM, recording='a.mcap') as arm:
        motion = arm.run(law, 0.2)
    for given in ({}, {'controller': law}):
        again = replayed('a.mcap', Path(f'{len(given)}.mcap'), **given)
        assert again.names == motion.names
        assert again.stopped == ''
        # The first row of a test is the state before the first step.
        np.testing.assert_array_equal(again.q[:-1], motion.q[1:])
        np.testing.assert_array_equal(again.tau, motion.tau)
        np.testing.assert_array_equal(again.limits.effort, motion.limits.effort)
    assert again.tip() == pytest.approx(recorded('a.mcap').tip())
    other = replayed('a.mcap', 'b.mcap', ['payload.mass=0.8'], controller=law)
    assert np.abs(other.q - again.q).max() > 1e-3
    assert findings('a.mcap', 'effort limit', 'shoulder') == []


def test_findings_of_a_kind_or_a_joint_that_there_is_not_are_an_error():
    simulate(Path('a.mcap'), 20)
    assert findings('a.mcap', 'oscillation', 'elbow') == []
    with pytest.raises(ValueError, match="kind is 'oscilation': did you mean 'oscillation'"):
        findings('a.mcap', 'oscilation', 'elbow')
    with pytest.raises(LogError, match="has no joint states of 'elbw'"):
        findings('a.mcap', 'oscillation', 'elbw')
