# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Format 2: each changed bit of a whole recording is found; harmless rewriting is not a change."""

from __future__ import annotations

import json
from pathlib import Path

from damage import parts_of, with_a_flip
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType
from plant_messages import efforts, joint_state
import pytest
from read_hostile import verified
from rewriting import ARRAY, GOLDEN, STATES, File, Recording, load
from simulating import simulate

from pfd_ros.arm.events import Source
from pfd_ros.cli.replay import INCOMPLETE
from pfd_ros.messages.convert import encode_string
from pfd_ros.recording import provenance
from pfd_ros.recording.format import END, HEAD, ROBOT
from pfd_ros.recording.head import strict_json
from pfd_ros.recording.recover import recover
from pfd_ros.replay.verify import DifferenceError, read

SETTINGS = {
    'outputs': ('acceleration', 'energy'),
    'noise_position': 1e-3,
    'drop_state': 0.1,
    'seed': 5,
    'joint_damping': (0.1, 0.2),
}


@pytest.fixture(scope='module')
def run() -> Recording:
    """Return a run with inputs of several kinds, good and bad, and all kinds of outputs."""
    return simulate(
        60,
        {
            3: [efforts(1.0, 2.0), (Source.NAMED, joint_state(['elbow'], effort=[0.5]))],
            9: [efforts(1.0), (Source.SET_STATE, joint_state(['elbow'], [0.2]))],
            20: [(Source.REQUEST, encode_string('reset'))],
            30: [(Source.PARAMETERS, encode_string(json.dumps({'real_time_factor': 2.0})))],
            31: [efforts(-1.0, 0.5)],
        },
        **SETTINGS,
    )


# --- one bit


def check_bits(whole: Recording, folder: Path, data: st.DataObject) -> None:
    """Check that a changed bit in each part of a recording is found."""
    # Definitions and QoS come from the golden recording; simulated runs have none.
    for kind in whole.channels:
        kind.definition = kind.definition or b'float64 x\n'
        kind.metadata = kind.metadata or {'offered_qos_profiles': '- depth: 1\n'}
    for message in whole.messages:
        message.published_ns = message.log_ns
    whole.recount()
    status, said = verified(whole.save(folder / 'whole.mcap'))
    assert status == 0, said
    for part, paths in parts_of(whole).items():
        path = data.draw(st.sampled_from(paths), part)
        altered = with_a_flip(whole, path, data.draw)
        status, said = verified(altered.save(folder / 'altered.mcap', sealed=False))
        # Under another name it is a record of another tool: the end record is missing.
        renamed = END not in [name for name, _ in altered.metadata]
        assert status == (INCOMPLETE if renamed else 1), (part, said)
        assert renamed or len(said.splitlines()) == 1, said


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder for files, which each example overwrites."""
    return tmp_path_factory.mktemp('bits')


# The first example changes bit 0 of byte 0 everywhere.
@settings(max_examples=3)
@given(data=st.data())
def test_a_changed_bit_in_each_part_of_a_recording_is_found(
    run: Recording, folder: Path, data: st.DataObject
) -> None:
    check_bits(run.copy(), folder, data)


@pytest.mark.long
@pytest.mark.parametrize('golden', [False, True], ids=['made up', 'golden'])
@settings(max_examples=15)
@given(data=st.data())
def test_fifteen_changed_bits_in_each_part_of_a_recording_are_found(
    run: Recording, folder: Path, data: st.DataObject, golden: bool
) -> None:
    check_bits(load(GOLDEN) if golden else run.copy(), folder, data)


# --- a head of another run


@pytest.mark.parametrize(
    ('name', 'value'), [('robot', 'panda'), ('seed', 6), ('real_time_factor', 2.0)]
)
def test_a_changed_setting_is_named(
    run: Recording, tmp_path: Path, name: str, value: object
) -> None:
    altered = run.copy()
    altered.seal()
    altered.edit(HEAD, 'settings', lambda settings: settings.update({name: value}))
    status, said = verified(altered.save(tmp_path / 'a.mcap', sealed=False))
    assert status == 1
    assert "the value 'settings' in its head is not the recorded one" in said


def test_a_changed_friction_of_the_robot_is_found_also_in_a_cut_off_file(tmp_path: Path) -> None:
    # The scene has no friction, so no state depends on it.
    altered = load(GOLDEN)
    (file,) = altered.attachments
    assert b'friction: 0.55443978' in file.data
    file.data = file.data.replace(b'friction: 0.55443978', b'friction: 0.55443979')
    for closed in (True, False):
        path = altered.save(tmp_path / 'a.mcap', sealed=False, closed=closed)
        status, said = verified(path)
        assert status == 1
        assert f'the attachment {ROBOT!r} in its head is not the recorded one' in said


def test_changed_log_times_are_found(run: Recording, tmp_path: Path) -> None:
    for name in ('log_ns', 'published_ns'):
        altered = run.copy()
        for message in altered.messages[20:]:
            setattr(message, name, message.log_ns + 1)
        status, said = verified(altered.save(tmp_path / 'a.mcap'))
        assert status == 1
        assert 'are not the recorded ones' in said


def test_an_end_record_of_another_run_is_refused(run: Recording, tmp_path: Path) -> None:
    other = simulate(60, {}, **(SETTINGS | {'seed': 6}))
    for each in (run, other):
        each.seal()
    altered = run.copy()
    altered.metadata[-1] = other.metadata[-1]
    status, said = verified(altered.save(tmp_path / 'a.mcap', sealed=False))
    assert status == 1
    assert 'the end record was altered: its digest does not match' in said


def test_a_changed_command_without_effect_is_found_in_a_cut_off_file(
    run: Recording, tmp_path: Path
) -> None:
    altered = run.copy()
    # The second one has one effort, and is refused.
    message = altered.on(ARRAY)[1]
    message.data = efforts(1.5)
    status, said = verified(altered.save(tmp_path / 'a.mcap', closed=False))
    assert status == 1
    assert 'message 2 of commands: recorded with CRC-32' in said


def test_a_recording_of_format_1_is_one_clear_line(run: Recording, tmp_path: Path) -> None:
    old = run.copy()
    old.head(HEAD)['format'] = '1'
    status, said = verified(old.save(tmp_path / 'a.mcap'))
    assert status == 1
    assert said.splitlines() == [
        f"pfd replay: {tmp_path / 'a.mcap'}: it has the recording format '1', expected '2': "
        'use the version of pfd that wrote it'
    ]


def test_recorded_settings_have_nothing_left_to_choose(run: Recording) -> None:
    settings = json.loads(run.head(HEAD)['settings'])
    assert len(settings) > 50
    assert 'auto' not in settings.values()


# --- the cause of a difference


def altered_state(run: Recording, *, recount: bool) -> Recording:
    altered = run.copy()
    altered.on(STATES)[30].flip()
    if recount:
        altered.recount()
    return altered


def cause(recording: Recording, path: Path, *, closed: bool = True) -> str:
    with pytest.raises(DifferenceError) as error:
        read(recording.save(path, closed=closed), verify=True)
    return str(error.value).partition('; cause: ')[2]


def test_a_difference_of_altered_messages_is_one_of_other_data(
    run: Recording, tmp_path: Path
) -> None:
    found = cause(altered_state(run, recount=False), tmp_path / 'a.mcap')
    assert found == 'other data, the messages joint_states are not the recorded ones'


def test_a_difference_of_another_program_names_both(run: Recording, tmp_path: Path) -> None:
    other = altered_state(run, recount=True)
    other.edit(HEAD, 'versions', lambda v: v.update(program='f' * 64, pfd='0.0.9', commit='abc'))
    found = cause(other, tmp_path / 'a.mcap')
    assert found.startswith(f'another program, recorded with digest {"f" * 64}, here ')
    assert 'pfd 0.0.9, here 0.1.0' in found
    assert 'commit abc, here ' in found


def test_a_difference_of_neither_is_one_of_the_processor(run: Recording, tmp_path: Path) -> None:
    found = cause(altered_state(run, recount=True), tmp_path / 'a.mcap')
    cpu = provenance.versions()['cpu']
    expected = 'not the program, the settings or the data; '
    assert found == f'{expected}processor {cpu}, here {cpu}'


def test_a_difference_of_a_cut_off_file_with_the_same_program_is_one_of_data(
    run: Recording, tmp_path: Path
) -> None:
    found = cause(altered_state(run, recount=False), tmp_path / 'a.mcap', closed=False)
    assert found == 'other data; the program is the same'


def test_the_digest_of_the_program_depends_on_the_compiled_program() -> None:
    def program(**settings: object) -> str:
        versions = json.loads(simulate(1, {}, **settings).head(HEAD)['versions'])
        return str(versions['program'])

    assert program() == program() == program(seed=7, noise_position=1e-3)
    different = {
        program(),
        program(joint_damping=(0.1, 0.2)),
        program(outputs=('energy',)),
        program(substeps=3),
    }
    assert len(different) >= 3


# --- harmless rewriting by other tools


def reorder_channels(recording: Recording) -> None:
    recording.channels.reverse()


def add_an_attachment(recording: Recording) -> None:
    recording.attachments.append(File('notes.txt', b'a note', 'text/plain'))


def add_a_metadata_record(recording: Recording) -> None:
    recording.metadata.insert(1, ('rosbag2', {'serialized_metadata': 'version: 9\n'}))


def sort_by_time(recording: Recording) -> None:
    recording.messages.sort(key=lambda message: message.log_ns)


def drop_empty_channels(recording: Recording) -> None:
    used = {message.topic for message in recording.messages}
    recording.channels = [kind for kind in recording.channels if kind.topic in used]


def nothing(recording: Recording) -> None:
    pass


HARMLESS = {
    'small chunks': (nothing, {'chunk_size': 500}),
    'large chunks': (nothing, {'chunk_size': 1 << 24}),
    'LZ4': (nothing, {'compression': CompressionType.LZ4}),
    'no compression': (nothing, {'compression': CompressionType.NONE}),
    'no chunks': (nothing, {'use_chunking': False}),
    'no checksums': (nothing, {'enable_crcs': False, 'enable_data_crcs': False}),
    'no index': (nothing, {'index_types': IndexType.NONE}),
    'no statistics': (nothing, {'use_statistics': False}),
    'no summary offsets': (nothing, {'use_summary_offsets': False}),
    'schemas in data alone': (nothing, {'repeat_schemas': False, 'repeat_channels': False}),
    'another library': (nothing, {'library': 'libmcap 1.3.0'}),
    'other channel numbers': (reorder_channels, {}),
    'another attachment': (add_an_attachment, {}),
    'another metadata record': (add_a_metadata_record, {}),
    'sorted by time': (sort_by_time, {}),
    'without empty channels': (drop_empty_channels, {}),
}


@pytest.mark.parametrize('name', HARMLESS)
def test_harmless_rewriting_is_no_change(run: Recording, tmp_path: Path, name: str) -> None:
    change, options = HARMLESS[name]
    rewritten = run.copy()
    rewritten.seal()
    change(rewritten)
    path = rewritten.save(tmp_path / 'a.mcap', sealed=False, **options)
    status, said = verified(path)
    assert (status, 'every bit equal' in said) == (0, True), said


def test_a_recovered_whole_recording_is_whole(run: Recording, tmp_path: Path) -> None:
    recover(run.copy().save(tmp_path / 'a.mcap'), tmp_path / 'b.mcap')
    assert verified(tmp_path / 'b.mcap')[0] == 0


def test_a_text_that_is_nested_too_deeply_is_one_error() -> None:
    with pytest.raises(ValueError, match='nested too deeply'):
        strict_json(100_000 * '[')
