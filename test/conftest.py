# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Set up every run: an empty cache of compiled kernels, and hypothesis with the same examples."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import redirect_stdout, suppress
import gc
from importlib import import_module
import io
import json
import os
from pathlib import Path
import sys
import tempfile
from types import ModuleType
from typing import Any

from hypothesis import HealthCheck, settings
import pytest

from pfd_core.kernels import native, threads
from pfd_core.kernels.cache import VARIABLE as CACHE_VARIABLE
from pfd_core.kernels.threads import cores

TESTS = str(Path(__file__).resolve().parent)
# benchmarks is not installed. At the end: pfd_core and pfd_ros are those that are installed.
sys.path.append(str(Path(__file__).resolve().parents[1]))
# Objects between two collections, and collections of one generation between those of the next: a
# recording makes hundreds of thousands of objects that live on.
COLLECTED = (50_000, 20, 50)
# What the collection of the tests makes lives on, too.
gc.disable()
# Of the parameters of a test that are all marked `slow`, one in so many is not `long`.
SAMPLED = 6

# Time limits depend on the machine; so does the health check for slow examples.
settings.register_profile(
    'repeatable',
    derandomize=True,
    database=None,
    deadline=None,
    max_examples=50,
    print_blob=False,
    suppress_health_check=[HealthCheck.too_slow],
)
# Searches for new failures: pytest --hypothesis-profile search -k hypothesis_test_name
settings.register_profile(
    'search', settings.get_profile('repeatable'), derandomize=False, max_examples=2000
)
settings.load_profile('repeatable')
# Hypothesis takes constants of all modules imported so far as examples. That depends on the order
# of the tests, and takes a second; no setting prevents it. Other versions may lack this module.
with suppress(ImportError):
    from hypothesis.internal.conjecture import providers

    providers._get_local_constants = lambda: providers._local_constants


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let all kernels of a run be compiled for another processor."""
    parser.addoption(
        '--target-cpu',
        metavar='NAME',
        help=f'compile for another level of x86-64, such as x86-64-v3; sets {native.VARIABLE}',
    )


def pytest_configure(config: pytest.Config) -> None:
    """Choose the processor, also for workers and for the processes that tests start."""
    # Hypothesis keeps constants of the sources; they do not belong into the folder of the project.
    storage = tempfile.TemporaryDirectory(prefix='hypothesis-')
    config.add_cleanup(storage.cleanup)
    os.environ.setdefault('HYPOTHESIS_STORAGE_DIRECTORY', storage.name)
    # The processes that tests start import modules of this folder too.
    path = os.environ.get('PYTHONPATH', '').split(os.pathsep)
    if TESTS not in path:
        os.environ['PYTHONPATH'] = os.pathsep.join([TESTS, *filter(None, path)])
    # Nothing is drawn; a look for libraries of windows takes a third of the time of the import.
    os.environ.setdefault('MUJOCO_GL', 'disable')
    cpu = config.getoption('--target-cpu')
    if cpu is not None:
        os.environ[native.VARIABLE] = cpu
    try:
        native.current()
    except ValueError as error:
        raise pytest.UsageError(str(error)) from None


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Return two workers more than processors: a test that waits for a node needs none."""
    return cores() + 2


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave what repeats a fast test, and most of what is slow alone, to the run of all tests."""
    _mark_sweeps(items)
    every = defaultdict[str, list[pytest.Item]](list)
    for item in items:
        every[item.nodeid.partition('[')[0]].append(item)
    for each in every.values():
        slow = [item for item in each if item.get_closest_marker('slow') is not None]
        for place, item in enumerate(slow):
            if len(slow) < len(each) or place % SAMPLED:
                item.add_marker('long')


def _mark_sweeps(items: list[pytest.Item]) -> None:
    """Mark parameters of a `sweep` as `slow`, but for a few with all values of all arguments."""
    sweeps = defaultdict[str, list[tuple[pytest.Item, set[tuple[str, int]]]]](list)
    for item in items:
        call = getattr(item, 'callspec', None)
        if call is None or item.get_closest_marker('sweep') is None:
            continue
        if item.get_closest_marker('slow') is None:
            # The items of a sweep share the objects that are their values.
            values = {(name, id(value)) for name, value in call.params.items()}
            sweeps[item.nodeid.partition('[')[0]].append((item, values))
    for left in sweeps.values():
        missing = set().union(*(values for _, values in left))
        while missing:
            fast = max(left, key=lambda each: len(each[1] & missing))
            left.remove(fast)
            missing -= fast[1]
        for item, _ in left:
            item.add_marker('slow')


def pytest_report_header() -> str | None:
    """Say which processor it is where it is not this machine's."""
    cpu = native.current().cpu
    return None if cpu == native.host().cpu else f'kernels are compiled for {cpu}'


def pytest_collection_finish() -> None:
    """Collect rarely, and never look at the modules again: a tenth of the time of all tests."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(*COLLECTED)
    gc.enable()


@pytest.fixture(scope='session', autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Leave the user's cache alone, also in the processes that tests start."""
    own = tmp_path_factory.getbasetemp()
    # The workers of one run share it: their folders lie side by side.
    where = (own.parent if 'PYTEST_XDIST_WORKER' in os.environ else own) / 'cache'
    where.mkdir(mode=0o700, exist_ok=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('PFD_CACHE', str(where))
        yield


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a cache folder of the test's own, which is in use and does not exist yet."""
    where = tmp_path / 'cache'
    monkeypatch.setenv(CACHE_VARIABLE, str(where))
    return where


@pytest.fixture
def emitted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return a growing list of the modules of IR that were compiled."""
    modules: list[str] = []
    emit = native.emit

    def counted(ir: str, *rest: Any) -> bytes:
        modules.append(ir)
        return emit(ir, *rest)

    monkeypatch.setattr('pfd_core.kernels.native.emit', counted)
    return modules


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Share batches in blocks of single registers, among more threads than cores."""
    monkeypatch.setattr('pfd_core.kernels.threads.MIN_BLOCK_WORK', 1)
    monkeypatch.setattr('pfd_core.kernels.threads.SINGLE_THREAD_WORK', 0)
    monkeypatch.setattr('pfd_core.kernels.threads.cores', lambda: 8)
    monkeypatch.setattr('pfd_core.kernels.threads._pool', None)
    threads._new_pool()


@pytest.fixture
def expanded_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Expand xacro files and MuJoCo models in this process: another imports for 0.3 s."""

    def answer_of(module: str, words: list[str], *_: str) -> Any:
        with redirect_stdout(io.StringIO()) as written:
            import_module(module).answer(*words)
        return json.loads(written.getvalue())

    for name in ('ament_index_python', 'ament_index_python.packages'):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))  # which the expansion replaces
    for name in [name for name in sys.modules if name.partition('.')[0] == 'xacro']:
        del sys.modules[name]  # which remembers packages that it found
    for module in ('mjcf', 'xacro_files'):
        monkeypatch.setattr(f'pfd_core.model.{module}.answer_of', answer_of)
