# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What-if with a controller in the loop: with the law of a log, its bits."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
import shlex
import sys
from typing import Any

from arm_messages import efforts
import pytest
from recordings import Run
from test_cli import command

from pfd_ros.recording.log import Log as RecordedLog
from pfd_ros.replay.verify import verify as verify_log
from pfd_ros.testing import ControllerProcess, LockstepArm

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
def laws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Write the controllers into the current folder, and return them."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, 'path', [*sys.path])
    Path('laws.py').write_text(LAWS)
    found: dict[str, Any] = {}
    exec(LAWS, found)
    return found


def states_of(path: Path | str) -> list[bytes]:
    return [m.data for m in RecordedLog(path).messages() if m.role == 'joint_states']


def driven(path: str, law: Callable[..., Any], **settings: Any) -> None:
    """Record a test that pushes, changes, sets and resets its arm between runs."""
    with LockstepArm(**ARM, **settings, recording=path) as arm:
        arm.run(law, 0.1)
        arm.push([5.0, 0.0, 0.0], [0.0, 1.0, 0.0])
        arm.run(law, 0.1)
        arm.set_state([0.1, 0.2])
        arm.set(payload_mass=0.5)
        arm.run(law, 0.1)
        arm.reset()
        arm.run(law, 0.1)


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
def test_the_law_that_made_a_log_in_lockstep_has_its_bits(kind: str, laws) -> None:
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


def test_a_controller_begins_where_the_recorded_one_did() -> None:
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
def test_the_changed_arm_moves_as_one_that_was_so_from_the_start(words: list[str], laws) -> None:
    settings = {x.partition('=')[0].replace('.', '_'): float(x.partition('=')[2]) for x in words}
    settings |= {'seed': int(settings['seed'])} if 'seed' in settings else {}

    def record(path: str, **more: Any) -> None:
        with LockstepArm(**{**ARM, 'start_time': 1.0, **more}, recording=path) as arm:
            arm.run(laws['pd'], 0.1)
            arm.push([5.0, 0.0, 0.0], [0.0, 1.0, 0.0])
            arm.run(laws['pd'], 0.1)

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
def test_a_controller_that_fails_is_named_and_its_run_is_recorded_up_to_there(
    fault: str, laws
) -> None:
    driven('a.mcap', laws['pd'])
    before = Path('a.mcap').read_bytes()
    status, printed, error = command(
        *('replay', 'a.mcap', '--what-if', '--controller', f'laws:{fault}', '--plot', 'a.svg')
    )
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
    words: str, status: int, message: str, laws
) -> None:
    driven('a.mcap', laws['pd'])
    Path('wrong.py').write_text('def (')
    given = words.split() if '"' in words else shlex.split(words)
    found = command('replay', 'a.mcap', *given)
    assert found[0] == status
    assert re.search(message, found[2])
    assert len(found[2].splitlines()) == 1
    assert not Path('a_what_if.mcap').exists()


# Kind of node, fault -> status, and the line FAILED.
NODES = {
    ('timer', ''): (0, ''),
    ('states', 'dies'): (1, 'ended by SIGSEGV at t = 0.021 s, after 20 answers'),
    ('states', 'nan'): (1, "not_finite: effort of joint 'elbow_joint' is nan"),
}


@pytest.mark.parametrize(('kind', 'fault'), NODES)
def test_an_unchanged_node_in_another_process_has_the_bits_of_its_log(
    kind: str, fault: str, ros_domain
) -> None:
    with (
        ControllerProcess([sys.executable, CONTROLLERS, kind]) as node,
        LockstepArm('ur5', armature=True, gravity_compensation=True, recording='a.mcap') as arm,
    ):
        arm.spin(0.1, node)
    words = shlex.join([sys.executable, str(CONTROLLERS), kind, *filter(None, [fault])])
    status, said = NODES[kind, fault]
    found = command('replay', 'a.mcap', '--what-if', '--process', words)
    assert found[0] == status, found
    assert said in found[1] if said else 'FAILED' not in found[1]
    assert verify_log('a_what_if.mcap').complete
    new, old = states_of('a_what_if.mcap'), states_of('a.mcap')
    assert len(old) == 100
    assert len(new) == (21 if fault == 'nan' else 20 if fault else 100)
    assert new[:20] == old[:20]
    assert fault or new == old


def test_a_simulation_that_fails_ends_the_run_with_its_time_and_status_0(laws) -> None:
    driven('a.mcap', laws['pd'])
    words = ['damping=[1e6, 1e6]', 'integrator=rk4', '--controller', 'laws:pd']
    status, printed, _ = command('replay', 'a.mcap', '--what-if', *words)
    assert status == 0
    assert 'FAILED     simulation stopped at 0.0' in printed
    assert verify_log('a_what_if.mcap').complete
