# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`pfd report log`: the page says what the log holds, escapes it, and draws it in a browser."""

from __future__ import annotations

import base64
import hashlib
from html.parser import HTMLParser
from itertools import pairwise
import json
from pathlib import Path
import re
from typing import Any

from bags import STORE, rosbag2
from browser import check_curves, drawn, needs_browser, screenshot
from hypothesis import given, settings, strategies
from mcap.writer import Writer
import numpy as np
import pinocchio as pin
from plant_messages import UNLIMITED, change, efforts, payload
import pytest
from rewriting import GOLDEN, Recording, load
from simulating import simulate

import pfd_core as pfd
from pfd_ros import read_log
from pfd_ros.cli.main import main
from pfd_ros.messages.convert import JOINT_STATE, JointStateEncoder
from pfd_ros.messages.definitions import full_text
from pfd_ros.page.curves import Curve
from pfd_ros.page.html import page
from pfd_ros.page.reading import read_contents
from pfd_ros.testing.engine_run import ArmError
from pfd_ros.testing.lockstep_arm import LockstepArm

HOSTILE = '</script><img src=x onerror=alert(1)>&"\'{{}}\u2028'
KP = np.array([400.0, 400, 400, 40, 40, 40])
# Of energies of some ten joules, summed in another order, J.
ENERGY_ROUNDING = 1e-13
TIP = 'tip_link'
GOAL = np.array([0.3, -0.6, 0.9, 0.2, -0.5, 0.4])


def faulty(t: float, q: Any, qd: Any) -> Any:
    """Return efforts whose proportional part changes its sign at 0.4 s."""
    return KP * (GOAL * np.sin(t) - q) * (1 if t < 0.4 else -1) - 0.1 * KP * qd


@pytest.fixture(scope='module')
def fault(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the recording of an arm whose controller turns unstable at 0.4 s."""
    path = tmp_path_factory.mktemp('fault') / 'fault.mcap'
    with LockstepArm('ur5', armature=True, gravity_compensation=True, recording=path) as arm:
        arm.run(faulty, 2.5)
    return path


@pytest.fixture(scope='module')
def fault_page(fault: Path) -> Path:
    out = fault.with_suffix('.html')
    assert main(['report', 'log', str(fault), '--out', str(out)]) == 0
    return out


def write_states(path: Path, topic: str, names: list[str], times_ns: list[int]) -> None:
    """Write a bag of another program, whose joints turn."""
    encoder = JointStateEncoder(names)
    with path.open('xb') as stream:
        writer = Writer(stream)
        writer.start(profile='ros2')
        schema = writer.register_schema(JOINT_STATE, 'ros2msg', full_text(JOINT_STATE).encode())
        channel = writer.register_channel(topic, 'cdr', schema)
        for at in times_ns:
            angles = np.sin(1e-9 * (at - times_ns[0]) + np.arange(len(names)))
            writer.add_message(channel, at, encoder.encode(at, angles, angles, angles), at)
        writer.finish()


# Curves.


@settings(max_examples=60, deadline=None)
@given(strategies.integers(1, 5), strategies.integers(0, 2**32 - 1), strategies.floats(0.0, 0.5))
def test_each_bin_has_the_extremes_of_its_samples(halvings: int, seed: int, gaps: float) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 500))
    values = rng.standard_normal((count, 2))
    values[rng.random(values.shape) < gaps] = np.nan
    curve = Curve(2)
    cuts = [0, *sorted(rng.integers(0, count + 1, 3).tolist()), count]
    for k, (start, end) in enumerate(pairwise(cuts)):
        curve.add(np.arange(start, end) * 1.0, values[start:end])
        if k < halvings:
            curve.coarsen()
    found = curve.drawn()
    assert (np.diff(found.time) >= 0.0).all()
    for column in range(2):
        known = values[~np.isnan(values[:, column]), column]
        if known.size:
            assert np.nanmin(found.values[:, column]) == known.min()
            assert np.nanmax(found.values[:, column]) == known.max()
        else:
            assert np.isnan(found.values[:, column]).all()


# What went wrong.


def test_the_first_finding_is_the_first_sample_beyond_a_limit(fault: Path) -> None:
    first = read_contents(fault).first
    assert first is not None
    log = read_log(fault)
    assert log.robot is not None
    states = log['/joint_states']
    beyond = np.abs(states.velocity) >= log.robot.velocity_limit
    limits = log.robot.position_lower, log.robot.position_upper
    beyond |= (states.position <= limits[0]) | (states.position >= limits[1])
    beyond |= np.abs(states.effort) >= log.robot.effort_limit
    k = int(np.argmax(beyond.any(axis=1)))
    assert first.time == pytest.approx(states.time[k], abs=1e-9)
    assert first.joint in np.array(states.names)[beyond[k]]
    # Unstable from 0.4 s on.
    assert 0.4 < first.time < 1.5


def test_each_rejected_input_is_named_with_its_reason() -> None:
    found = [f for f in read_contents(GOLDEN).findings if f.kind == 'rejected input']
    # The golden run sends one message of each kind; `pfd info` counts twelve.
    assert sum(f.count for f in found) == 12
    text = ' '.join(f.text for f in found)
    for reason in ('ragged', 'stale', 'wrong_size', 'not_finite', 'malformed', 'all_nan'):
        assert f'rejected as {reason}' in text
    assert "effort of 'joint1' is nan" in text


def test_the_watchdog_and_an_infinite_state_have_their_times(tmp_path: Path) -> None:
    path = tmp_path / 'silent.mcap'
    settings = {'command_timeout': 0.05, **UNLIMITED}
    with LockstepArm('planar2', recording=path, publish_rate=10.0, **settings) as arm:
        arm.run(lambda t, q, qd: np.zeros(2), 0.3)
    (watchdog,) = (f for f in read_contents(path).findings if f.kind == 'watchdog')
    # Commands come each 0.1 s, the first one before the step from 0.001 s.
    assert watchdog.time == pytest.approx(0.051, abs=2e-3)
    assert watchdog.count == 3


def test_a_run_without_problems_lists_the_checks(tmp_path: Path) -> None:
    path = tmp_path / 'good.mcap'
    with LockstepArm('planar2', recording=path, gravity=[0.0, 0.0, 0.0]) as arm:
        arm.run(lambda t, q, qd: np.full(2, 0.1), 0.2)
    contents = read_contents(path)
    assert contents.first is None
    assert not contents.findings
    assert 'rejected inputs' in contents.checked
    assert 'Nothing went wrong' in page(contents)


def test_a_failed_simulation_and_files_of_one_run_are_reported(tmp_path: Path) -> None:
    endless = {'recording_max_duration': 0.05, **UNLIMITED}
    arm = LockstepArm('planar2', recording=tmp_path / 'run.mcap', **endless)
    with arm, pytest.raises(ArmError):
        arm.run(lambda t, q, qd: 0 * q + (1e300 if t > 0.1 else 0.0), 0.3)
    first, *_, last = (read_contents(path) for path in sorted(tmp_path.glob('run_*.mcap')))
    assert 'the run continues in another file' in first.notes
    assert any('the run begins in another file' in note for note in last.notes)
    (failure,) = (f for f in last.findings if f.kind == 'failure')
    assert failure.time == pytest.approx(0.101)
    assert 'not finite' in failure.text


def energy_by_pinocchio(body: pin.Inertia | None, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
    """Return kinetic and potential energy (N, 2) of planar2 with a body at its tip."""
    model = pin.buildModelFromXML(pfd.urdf_of('planar2'))
    if body is not None:
        tip = model.frames[model.getFrameId(TIP)]
        model.appendBodyToJoint(tip.parentJoint, body, tip.placement)
    data, found = model.createData(), []
    for angles, rates in zip(q, qd, strict=True):
        # Continuous joints have the cosine and the sine of their angle.
        place = np.stack([np.cos(angles), np.sin(angles)], axis=1).ravel()
        kinetic = pin.computeKineticEnergy(model, data, place, rates)
        found.append((kinetic, pin.computePotentialEnergy(model, data, place)))
    return np.array(found)


def test_the_energy_follows_the_payload_of_the_run(tmp_path: Path) -> None:
    center, inertia = (0.1, -0.05, 0.02), (0.03, 0.001, 0.002, 0.02, 0.001, 0.025)
    taken = {
        1: [efforts(0.5, -0.2)],
        100: [payload(TIP, 2.5, center, inertia)],
        200: [payload(TIP, 0.0)],
        250: [change(payload_mass=0.5)],
    }
    path = simulate(300, taken, payload_mass=1.0).save(tmp_path / 'a.mcap')
    (plot,) = (plot for plot in read_contents(path).plots if plot.title == 'energy')
    found = plot.curve.drawn().values
    states = read_log(path)['/joint_states']
    xx, xy, xz, yy, yz, zz = inertia
    heavy = pin.Inertia(
        2.5, np.array(center), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    )
    bodies = [pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), heavy, None]
    bodies.append(pin.Inertia(0.5, np.zeros(3), np.zeros((3, 3))))
    # A change acts in the step that takes it, whose state is the one before in this order.
    for body, begin, end in zip(bodies, (0, 99, 199, 249), (99, 199, 249, 300), strict=True):
        some = slice(begin, end)
        wanted = energy_by_pinocchio(body, states.position[some], states.velocity[some])
        np.testing.assert_allclose(found[some, :2], wanted, rtol=0, atol=ENERGY_ROUNDING)


def test_the_last_command_is_an_event_if_the_log_continues(tmp_path: Path) -> None:
    path = tmp_path / 'silent.mcap'
    simulate(400, {100: [efforts(0.0, 0.0)], 150: [efforts(0.0, 0.0)]}).save(path)
    found = [f for f in read_contents(path).findings if 'the last command' in f.text]
    assert [f.severity for f in found] == ['note']
    assert 'none in the 0.25' in found[0].text


def test_missing_states_are_a_gap_and_no_line_crosses_it(tmp_path: Path) -> None:
    path = tmp_path / 'gap.mcap'
    times = [10**18 + k * 10**7 for k in range(100) if not 40 <= k < 60]
    write_states(path, '/arm/joint_states', ['a', 'b'], times)
    contents = read_contents(path)
    (gap,) = (f for f in contents.findings if f.kind == 'gap')
    assert gap.spans == [pytest.approx((0.39, 0.60))]
    values = contents.plots[0].curve.drawn().values
    assert np.isnan(values[40]).all()
    assert np.isfinite(values[[39, 41]]).all()


def test_the_robot_of_another_bag_gives_its_limits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'bag.mcap'
    names = list(pfd.load_robot('ur5').joint_names)
    write_states(path, '/joint_states', names, [10**18 + k * 10**7 for k in range(50)])
    with_robot = read_contents(path, robot=pfd.load_robot('ur5'))
    assert any('limits of' in text for text in with_robot.checked)
    assert any('limits (' in text for text in read_contents(path).unchecked)
    out = tmp_path / 'page.html'
    assert main(['report', 'log', str(path), '--robot', 'ur5', '--out', str(out)]) == 0
    assert 'nothing went wrong' in capsys.readouterr().out


@pytest.mark.parametrize('storage', [rosbag2.StoragePlugin.SQLITE3, rosbag2.StoragePlugin.MCAP])
def test_diagnostics_of_any_bag_are_findings(tmp_path: Path, storage: Any) -> None:
    kind = 'diagnostic_msgs/msg/DiagnosticArray'
    types = STORE.types
    pairs = [types['diagnostic_msgs/msg/KeyValue'](key='x', value='1')]
    with rosbag2.Writer(tmp_path / 'bag', version=9, storage_plugin=storage) as writer:
        connection = writer.add_connection('/diagnostics', kind, typestore=STORE)
        for k, level in enumerate((0, 1, 2)):
            stamp = types['builtin_interfaces/msg/Time'](sec=k + 1, nanosec=0)
            header = types['std_msgs/msg/Header'](stamp=stamp, frame_id='')
            status = types['diagnostic_msgs/msg/DiagnosticStatus'](
                level=level, name='drive', message=f'level {level}', hardware_id='', values=pairs
            )
            data = STORE.serialize_cdr(types[kind](header=header, status=[status]), kind)
            writer.write(connection, 10**9 * (k + 1), bytes(data))
    contents = read_contents(tmp_path / 'bag')
    found = [(f.severity, f.text) for f in contents.findings]
    assert found == [('warning', 'drive: level 1'), ('bad', 'drive: level 2')]
    assert 'the log has no joint states' in contents.notes


# Hostile and damaged logs.


class Tags(HTMLParser):
    """Counts the tags of a page and collects their attributes."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: dict[str, list[str]] = {}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            self.attributes.setdefault(name, []).append(value or '')


def test_hostile_names_stay_text(tmp_path: Path) -> None:
    times = [10**18 + k * 10**7 for k in range(20)]
    pages = []
    for k, name in enumerate(('harmless', HOSTILE)):
        path = tmp_path / f'{k}.mcap'
        write_states(path, f'/{name}/joint_states', [name, 'b'], [*times, times[-1] + 10**9])
        contents = read_contents(path)
        pages.append(page(contents))
    tags = []
    for text in pages:
        parser = Tags()
        parser.feed(text)
        tags.append(parser)
    assert tags[0].tags == tags[1].tags
    assert 'onerror' not in tags[1].attributes
    data = re.search('id="data">(.*?)</script>', pages[1], re.DOTALL)
    assert data is not None
    labels = json.loads(data[1])['plots'][0]['labels']
    assert labels[0].startswith('</script><img src=x onerror=alert(1)>')


def test_a_page_refers_to_nothing_and_runs_only_its_own_scripts(fault_page: Path) -> None:
    text = fault_page.read_text(encoding='utf-8')
    parser = Tags()
    parser.feed(text)
    assert not {'src', 'href', 'style', 'onclick', 'onload'} & parser.attributes.keys()
    assert 'link' not in parser.tags
    policy = parser.attributes['content'][0]
    assert policy.startswith("default-src 'none'; script-src 'sha256-")
    assert 'unsafe' not in policy
    scripts = re.findall('<script>(.*?)</script>', text, re.DOTALL)
    assert len(scripts) == 2
    for script in scripts:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy


def test_a_log_that_was_cut_off_is_shown_up_to_the_cut(
    tmp_path: Path, fault: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, path = fault.read_bytes(), tmp_path / 'cut.mcap'
    path.write_bytes(whole[: 2 * len(whole) // 3])
    assert main(['report', 'log', str(path), '--out', str(tmp_path / 'page.html')]) == 0
    assert 'the file is cut off' in capsys.readouterr().out
    assert read_contents(path).plots[0].curve.samples > 500


def test_messages_before_damage_are_shown(tmp_path: Path, fault: Path) -> None:
    data = bytearray(fault.read_bytes())
    middle = 2 * len(data) // 3
    data[middle : middle + 4000] = bytes(4000)
    path = tmp_path / 'damaged.mcap'
    path.write_bytes(data)
    contents = read_contents(path)
    assert any(str(path) in note for note in contents.notes)
    assert contents.plots[0].curve.samples > 500


# Cut short, numbers that are NaN, and numbers as large as there are.
WRONG = strategies.sampled_from((b'', b'\xff' * 8, bytes(6) + b'\xf0\x7f'))


@strategies.composite
def hostile_messages(draw: strategies.DrawFn) -> Recording:
    """Draw the golden recording with tens of messages that are damaged or have a wrong time."""
    found = load(GOLDEN)
    numbers = strategies.integers(0, len(found.messages) - 1)
    for number in draw(strategies.lists(numbers, min_size=20, max_size=60, unique=True)):
        message = found.messages[number]
        at = draw(strategies.integers(0, len(message.data)))
        message.data = message.data[:at] + draw(WRONG) + message.data[at + 8 :]
    for number in draw(strategies.lists(numbers, max_size=6)):
        found.messages[number].log_ns = draw(strategies.sampled_from((0, (1 << 63) - 1)))
    return found


@pytest.fixture(scope='module')
def hostile_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the path of a file, which each example overwrites."""
    return tmp_path_factory.mktemp('hostile') / 'hostile.mcap'


@settings(max_examples=12)
@given(recording=hostile_messages())
def test_hostile_messages_in_a_whole_file_do_not_hide_the_others(
    recording: Recording, hostile_path: Path
) -> None:
    path = recording.save(hostile_path)
    contents = read_contents(path)
    text = page(contents)
    data_text = re.search('id="data">(.*?)</script>', text, re.DOTALL)
    assert data_text is not None
    assert json.loads(data_text[1])['plots'][0]['title'] == 'position'
    # 269 states, and breaks in the curve where states are damaged.
    assert contents.plots[0].curve.samples > 200


@pytest.mark.parametrize('data', [b'', b'not a log', b'\x89MCAP0\r\n' + bytes(100)])
def test_a_file_that_is_no_log_is_one_line_and_no_page(
    tmp_path: Path, data: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / 'x.mcap', tmp_path / 'page.html'
    path.write_bytes(data)
    assert main(['report', 'log', str(path), '--out', str(out)]) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert 'x.mcap' in line
    assert not out.exists()


def test_a_page_is_never_overwritten(
    tmp_path: Path, fault: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'page.html'
    out.write_text('mine')
    assert main(['report', 'log', str(fault), '--out', str(out)]) == 1
    assert 'is not overwritten' in capsys.readouterr().err
    assert out.read_text() == 'mine'


# In a browser.


@needs_browser
def test_the_browser_draws_each_curve_with_the_values_of_the_log(
    fault: Path, fault_page: Path, tmp_path: Path
) -> None:
    report = drawn(fault_page, tmp_path)
    check_curves(report)
    states = read_log(fault)['/joint_states']
    plots = {plot['title']: plot for plot in report['plots']}
    assert plots.keys() >= {'position', 'velocity', 'effort', 'commanded effort', 'energy'}
    assert plots.keys() >= {'error estimate', 'period'}
    for item in ('position', 'velocity', 'effort'):
        for column, series in enumerate(plots[item]['series']):
            values = getattr(states, item)[:, column]
            tolerance = 2e-5 * np.ptp(values)
            assert series['label'] == states.names[column]
            assert series['count'] == len(values)
            assert series['low'] == pytest.approx(values.min(), abs=tolerance)
            assert series['high'] == pytest.approx(values.max(), abs=tolerance)
        assert plots[item]['time'] == pytest.approx([states.time[0], states.time[-1]], abs=2e-6)


@needs_browser
def test_zooming_one_plot_zooms_all(fault_page: Path, tmp_path: Path) -> None:
    report = drawn(fault_page, tmp_path, '#check-zoom')
    low, high = report['ranges'][1]
    assert 0.5 < low < high < 1.5
    assert all(found == [low, high] for found in report['ranges'])


@needs_browser
@pytest.mark.parametrize(
    'dark', [False, pytest.param(True, marks=pytest.mark.long)], ids=['light', 'dark']
)
def test_curves_are_on_the_screen_in_light_and_dark(
    fault_page: Path, tmp_path: Path, dark: bool
) -> None:
    options = ['--force-dark-mode'] if dark else []
    pixels = screenshot(fault_page, tmp_path, 1440, 900, *options)
    background = pixels[-5, 5]
    assert (background.mean() < 0.3) == dark
    plots = pixels[60:, 400:]
    # Curves are the only saturated colours there, but for the red of the findings.
    saturated = (plots.max(axis=2) - plots.min(axis=2) > 0.35) & (
        plots[..., 0] < plots[..., 1:].max(axis=2)
    )
    assert saturated.any(axis=0).mean() > 0.6
    assert saturated.sum() > 3000


@needs_browser
def test_hostile_names_draw_without_errors(tmp_path: Path) -> None:
    path, out = tmp_path / 'bag.mcap', tmp_path / 'page.html'
    times = [10**18 + k * 10**7 for k in range(200)]
    write_states(path, f'/{HOSTILE}/joint_states', [HOSTILE, 'b'], times)
    assert main(['report', 'log', str(path), '--out', str(out)]) == 0
    report = drawn(out, tmp_path)
    check_curves(report)
    assert report['plots'][0]['series'][0]['label'].startswith('</script>')
