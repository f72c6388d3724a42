# Copyright 2026 The pfd_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Imports point one way, tools that read the source find nothing, installations are complete."""

from __future__ import annotations

import ast
from configparser import ConfigParser
from functools import cache
from graphlib import TopologicalSorter
import importlib
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
from typing import Any
import xml.etree.ElementTree as ET
import zipfile

import pytest

import pfd_core as pfd

ROOT = Path(__file__).resolve().parent.parent
# Each package or subpackage, and the others that it may import; `machine` imports no robots.
# Modules directly in a package may import all its subpackages, and no subpackage imports them.
PFD_CORE = {
    'forking': set(),
    'machine': {'forking'},
    'model': {'forking', 'machine'},
    # Reaches `paper` by the names in its tables alone.
    'dynamics': {'forking', 'model', 'machine'},
    'paper': {'forking', 'model', 'machine', 'dynamics'},
    'kernels': {'forking', 'model', 'machine', 'dynamics'},
    'simulation': {'forking', 'model', 'machine', 'dynamics', 'kernels'},
}
KERNELS = {
    'simplify': set(),
    'sines': set(),
    'schedule': {'simplify'},
    'lower': {'simplify', 'sines', 'schedule'},
    'ir': set(),
    'parts': set(),
    'generate': {'ir', 'parts', 'sines'},
    'script': {'generate', 'ir'},
    'simulate': {'generate', 'ir', 'script'},
}
PFD_ROS = {
    'text': set(),
    'files': set(),
    'extras': set(),
    'messages': {'text'},
    'arm': {'text', 'messages'},
    'recording': {'text', 'files', 'messages', 'arm'},
    'replay': {'text', 'files', 'extras', 'messages', 'arm', 'recording'},
    'motion': set(),
    'page': {'text', 'files', 'messages', 'arm', 'recording', 'motion'},
    'advice': {'text', 'files', 'messages', 'arm', 'recording', 'replay'},
    'node': {'text', 'files', 'messages', 'arm', 'recording', 'replay'},
    'testing': {
        *('text', 'files', 'messages', 'arm', 'recording', 'replay', 'motion', 'page', 'node')
    },
    'view': {'text', 'files', 'extras', 'messages', 'arm', 'recording', 'node', 'testing'},
    'demo': {
        *('text', 'extras', 'messages', 'arm', 'recording', 'replay', 'page', 'node'),
        *('testing', 'view'),
    },
    'starter': {'text', 'messages', 'arm', 'recording'},
    'cli': {
        *('text', 'files', 'messages', 'arm', 'recording', 'replay', 'page', 'advice', 'node'),
        *('extras', 'testing', 'view', 'demo', 'starter'),
    },
}
SIMULATION: dict[str, set[str]] = {'contact': set()}
ORDERS = {
    'pfd_core': PFD_CORE,
    'pfd_core.kernels': KERNELS,
    'pfd_core.simulation': SIMULATION,
    'pfd_ros': PFD_ROS,
}
# Outside packages that only some may know.
RESERVED = {
    'llvmlite': {'pfd_core.kernels'},
    'pinocchio': set(),
    'benchmarks': set(),
    'viser': {'pfd_ros.view'},
    'rosbags': {'pfd_ros.messages.columns', 'pfd_ros.replay.playlist'},
    'trimesh': {'pfd_ros.view'},
    'rclpy': {
        'pfd_ros.node',
        'pfd_ros.testing',
        'pfd_ros.demo',
        'pfd_ros.view.live',
        'pfd_ros.cli.send',
        'pfd_ros.replay.publish',
        'pfd_ros.messages.matching',
    },
}


def modules() -> dict[str, Path]:
    """Return the modules of both packages, by full name."""
    return {
        '.'.join(path.relative_to(ROOT).with_suffix('').parts).removesuffix('.__init__'): path
        for package in ('pfd_core', 'pfd_ros')
        for path in sorted((ROOT / package).rglob('*.py'))
    }


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding='utf-8'))


@cache
def imported_by(path: Path) -> list[str]:
    """Return the full name of each module, or name in a module, that a file imports."""
    found = list[str]()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            found += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{path}: relative import'
            found += (f'{node.module}.{alias.name}' for alias in node.names)
    return found


def member(name: str, package: str) -> str:
    """Return the member of a package in which a module lies, '' if it lies elsewhere."""
    inside = name.startswith(f'{package}.')
    return name[len(package) + 1 :].partition('.')[0] if inside else ''


def test_imports_point_one_way() -> None:
    found = list[str]()
    for module, path in modules().items():
        for name in imported_by(path):
            if module.startswith('pfd_core') and name.startswith('pfd_ros'):
                found.append(f'{module} imports {name}')
            for package, order in ORDERS.items():
                importer, imported = member(module, package), member(name, package)
                if importer not in order or not imported or imported.startswith('_'):
                    continue
                if imported != importer and imported not in order[importer]:
                    found.append(f'{module} imports {name}')
            outside = name.partition('.')[0]
            subpackages = RESERVED.get(outside)
            if subpackages is not None and not any(
                f'{module}.'.startswith(f'{subpackage}.') for subpackage in subpackages
            ):
                found.append(f'{module} imports {name}')
    assert not found, '\n'.join(found)


def test_every_folder_of_a_layered_package_is_one_of_its_subpackages() -> None:
    for package, order in ORDERS.items():
        folder = ROOT / package.replace('.', '/')
        subpackages = {path.parent.name for path in folder.glob('*/__init__.py')}
        assert subpackages == {name for name in order if (folder / name).is_dir()}


def test_the_docstring_of_each_package_is_a_map_of_its_modules() -> None:
    for init in (path for path in modules().values() if path.name == '__init__.py'):
        members = {path.stem for path in init.parent.glob('*.py')} - {'__init__', '_types'}
        members |= {path.parent.name for path in init.parent.glob('*/__init__.py')}
        docstring = ast.get_docstring(tree_of(init)) or ''
        lines = re.findall(r'^    (\w+)/? {2,}\S', docstring, re.MULTILINE)
        assert sorted(lines) == sorted(members), init


def defined(path: Path) -> set[str]:
    """Return the names that a module defines, those of the members of a class with its name."""
    found = set()
    for node in tree_of(path).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            found.add(node.name)
            members = [x for x in node.body if isinstance(x, ast.FunctionDef)]
            found |= {f'{node.name}.{member.name}' for member in members}
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, 'target', node)]
        found |= {target.id for target in targets if isinstance(target, ast.Name)}
    return found


def unknown_names(docstring: str, found: dict[str, Path]) -> list[str]:
    """Return the dotted names and the files in a docstring that do not exist."""
    wrong = []
    packages = dict.fromkeys(PFD_CORE, 'pfd_core.') | dict.fromkeys(PFD_ROS, 'pfd_ros.')
    pattern = rf'(?<![\w./])(pfd_(?:core|ros)\.)?({"|".join(packages)})((?:\.\w+)+)'
    for package, subpackage, rest in re.findall(pattern, docstring):
        parts = f'{package or packages[subpackage]}{subpackage}{rest}'.split('.')
        name, attributes = '.'.join(parts), list[str]()
        while '.'.join(parts) not in found:
            attributes.insert(0, parts.pop())
        if attributes and '.'.join(attributes) not in defined(found['.'.join(parts)]):
            wrong.append(name)
    files = re.findall(r'\b(?:config|docs|test)/[\w/]+\.\w+', docstring)
    return wrong + [name for name in files if not (ROOT / name).is_file()]


@pytest.mark.parametrize(
    'package',
    [
        *('pfd_core', *(f'pfd_core.{name}' for name in PFD_CORE)),
        *('pfd_ros', *(f'pfd_ros.{name}' for name in PFD_ROS)),
    ],
)
def test_every_name_in_the_docstring_of_a_package_exists(package: str) -> None:
    found = modules()
    docstring = ast.get_docstring(tree_of(found[package])) or ''
    assert unknown_names(docstring, found) == []
    wrong = ['arm.nothing', 'node.report.nothing', 'nothing.report.Report', 'docs/nothing.md']
    wrong += ['node.report.Report.nothing', 'pfd_core.dynamics.nothing']
    expected = ['pfd_ros.arm.nothing', 'pfd_ros.node.report.nothing']
    expected += ['pfd_ros.node.report.Report.nothing', *wrong[5:], wrong[3]]
    assert unknown_names(f'{docstring} {" ".join(wrong)}', found) == expected


def test_names_of_functions_that_tables_load_at_first_use_exist() -> None:
    name = re.compile(rf'({"|".join(PFD_CORE)})(\.\w+){{2}}')
    found = {
        node.value
        for path in (ROOT / 'pfd_core').rglob('*.py')
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and name.fullmatch(node.value)
    }
    assert len(found) >= len(pfd.QUANTITIES)
    for path in found:
        module, _, attribute = f'pfd_core.{path}'.rpartition('.')
        assert hasattr(importlib.import_module(module), attribute), path


def test_no_circle_of_imports() -> None:
    graph, found = {}, modules()
    for module, path in found.items():
        names = {name if name in found else name.rpartition('.')[0] for name in imported_by(path)}
        graph[module] = (names & found.keys()) - {module}
    TopologicalSorter(graph).prepare()


# doctor looks at the cache of compiled kernels and the processor that they are compiled for.
LOOKS_INSIDE = 'pfd_ros.cli.doctor', 'pfd_core.kernels.'


def test_pfd_ros_uses_only_the_public_names_of_pfd_core() -> None:
    found = [
        f'{module}: {name}'
        for module, path in modules().items()
        if module.startswith('pfd_ros')
        for name in imported_by(path)
        if member(name, 'pfd_core') in PFD_CORE
        and not (module == LOOKS_INSIDE[0] and name.startswith(LOOKS_INSIDE[1]))
    ]
    assert not found, '\n'.join(found)


# Modules and lines of pfd_core that a process imports to compile a kernel of a UR5, at most; no
# times, which depend on the machine. With the program and the code on disk: the model, the tables
# of names, and what loads and calls native code. With an empty cache also the machine, the default
# method, the measurement that chooses it, the passes and the writer of LLVM IR. No other method
# and no simulation.
MOST_COLD, MOST_WARM = (65, 14_000), (28, 6_500)
COMPILING = """
import json, sys
import pfd_core as pfd
first = [name for name in sys.modules if name.startswith(('pfd_core', 'numpy', 'llvmlite'))]
pfd.compile_kernel(pfd.load_robot('ur5'))
files = [module.__file__ for name, module in sys.modules.items() if name.startswith('pfd_core')]
lines = sum(len(open(file, encoding='utf-8').readlines()) for file in files)
print(json.dumps([sorted(first), len(files), lines]))
"""
# The first uses of public names by many threads at once.
THREADS = """
import json, sys
from concurrent.futures import ThreadPoolExecutor
import pfd_core as pfd
sys.setswitchinterval(1e-6)
names = [name for name in dir(pfd) if not name.startswith('_')] * 50
with ThreadPoolExecutor(16) as pool:
    found = pool.map(lambda name: getattr(pfd, name), names)
print(json.dumps(all(x is getattr(pfd, name) for name, x in zip(names, found, strict=True))))
"""


def printed(script: str, **environment: str) -> Any:
    """Return the JSON that a script prints in a fresh process."""
    done = subprocess.run(
        [sys.executable, '-c', script],
        cwd=ROOT,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    return json.loads(done.stdout)


def test_a_process_imports_the_modules_that_its_kernel_needs(tmp_path: Path) -> None:
    cold, warm = (printed(COMPILING, PFD_CACHE=str(tmp_path / 'cache')) for _ in range(2))
    for (first, *sizes), most in ((cold, MOST_COLD), (warm, MOST_WARM)):
        assert first == ['pfd_core', 'pfd_core.forking']
        assert all(size <= bound for size, bound in zip(sizes, most, strict=True)), sizes
    assert warm[1] < cold[1], 'the kernel was not read from the cache'


def test_every_public_name_is_listed_and_resolves() -> None:
    assert len(set(pfd.__all__)) == len(pfd.__all__)
    assert set(pfd.__all__) <= set(dir(pfd))
    star: dict[str, Any] = {}
    exec('from pfd_core import *', star)
    for name in pfd.__all__:
        assert star[name] is getattr(pfd, name)
    with pytest.raises(AttributeError, match="module 'pfd_core' has no attribute 'Robots'"):
        _ = pfd.Robots  # type: ignore[attr-defined]


def test_type_checkers_see_the_module_that_each_public_name_is_loaded_from() -> None:
    found = {
        name.rpartition('.')[2]: name.rpartition('.')[0]
        for name in imported_by(ROOT / 'pfd_core' / '__init__.py')
        if member(name, 'pfd_core') in PFD_CORE.keys() - {'forking'}
    }
    assert found == {name: f'pfd_core.{module}' for name, module in pfd._MODULES.items()}
    assert {*found, '__version__'} == set(pfd.__all__)


def test_many_threads_may_use_public_names_first() -> None:
    assert printed(THREADS) is True


FORMATTED = ('pfd_core', 'pfd_ros', 'test', 'benchmarks', 'launch', 'packaging', 'setup.py')


@pytest.mark.parametrize(
    'command',
    [('ruff', 'check', *FORMATTED), ('ruff', 'format', '--check', *FORMATTED), ('mypy',)],
    ids=['lint', 'format', 'types'],
)
def test_the_source_passes(command: tuple[str, ...]) -> None:
    tool = shutil.which(command[0], path=str(Path(sys.executable).parent)) or command[0]
    done = subprocess.run(
        [tool, *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr


TIMEOUT = 240.0
CORE = 'packaging/pfd-core'
TEMPLATES = ROOT / 'pfd_ros/starter/templates'
CLEAN = ('.git', '.venv', 'build', 'install', 'log', '__pycache__', '*.egg-info', '.*_cache')


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """Return a copy of the sources, which a build may write into."""
    target = tmp_path / 'src' / 'pfd_ros'
    shutil.copytree(ROOT, target, ignore=shutil.ignore_patterns(*CLEAN))
    return target


def run(command: list[str], folder: Path, **environment: str) -> str:
    done = subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=TIMEOUT,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def installed(sources: Path) -> dict[str, str]:
    """Return the text of each file that setup.py installs, by path; it takes half a second."""
    root = sources / 'dist'
    options = ('--root', str(root), '--single-version-externally-managed', '--no-compile')
    run([sys.executable, 'setup.py', '-q', 'install', *options], sources)
    files = [path for path in root.rglob('*') if path.is_file()]
    return {str(path): path.read_text(encoding='utf-8') for path in files}


def wheel(sources: Path) -> dict[str, str]:
    """Return the text of each file in the wheel, by path; pip fetches its tools for that."""
    run([sys.executable, '-m', 'pip', 'wheel', '--no-deps', '-q', '-w', 'dist', '.'], sources)
    (path,) = (sources / 'dist').glob('*.whl')
    with zipfile.ZipFile(path) as found:
        return {part: found.read(part).decode() for part in found.namelist()}


PARTS = (
    'pfd_core/kernels/kernel.py',
    'pfd_core/py.typed',
    'pfd_ros/py.typed',
    'pfd_core/config/robots/puma560.yaml',
    'pfd_core/config/sim_arm.yaml',
    'pfd_ros/node/main.py',
    'pfd_ros/testing/loopback.xml',
    *(str(path.relative_to(ROOT)) for path in TEMPLATES.rglob('*.in')),
    *(f'pfd_ros/page/assets/{path.name}' for path in (ROOT / 'pfd_ros/page/assets').iterdir()),
    'share/pfd_ros/package.xml',
    'share/pfd_ros/config/sim_arm.yaml',
    'share/pfd_ros/launch/two_arms.launch.py',
    'share/ament_index/resource_index/packages/pfd_ros',
)
USED = """
import sys
assert pfd.__file__.startswith(sys.path[1]), pfd.__file__
print(run.status, trajectory.q.shape, {'pfd_ros', 'rclpy', 'pinocchio'} & {*sys.modules})
"""


def packages_needed(files: dict[str, str]) -> dict[str, set[str]]:
    """Return the packages that an installation and each of its extras need."""
    (text,) = (text for name, text in files.items() if name.endswith('egg-info/requires.txt'))
    found = ConfigParser(allow_no_value=True, delimiters=['\0'])
    found.read_string(f'[all]\n{text}')
    return {name: {*found[name]} for name in found.sections()}


def test_installations_are_complete_and_the_library_alone_runs_without_ros(copy: Path) -> None:
    both, core = (installed(copy / part) for part in ('.', CORE))
    assert [part for part in PARTS if not any(name.endswith(part) for name in both)] == []
    needed, of_core = packages_needed(both), packages_needed(core)
    assert all(names <= needed[extra] for extra, names in of_core.items())
    # Wheels of ROS would lie over a machine's own.
    ros = {extra: sum('ros-jazzy' in x for x in names) for extra, names in needed.items()}
    assert {extra: count for extra, count in ros.items() if count} == {'ros': 3}
    (site,) = {name.partition('pfd_core/')[0] for name in core if name.endswith('py.typed')}
    (where,) = {name.partition('pfd_core/')[0] for name in both if name.endswith('core/py.typed')}
    for name, text in core.items():
        assert not name.endswith('.py') or both[name.replace(site, where)] == text
    code = (copy / CORE / 'README.md').read_text().split('```python')[1].split('```')[0]
    said = run([sys.executable, '-c', code + USED], copy.parent, PYTHONPATH=site)
    assert said == 'ok (1000, 6) set()\n'


@pytest.mark.long
def test_a_wheel_is_complete(copy: Path) -> None:
    files = wheel(copy)
    assert [part for part in PARTS if not any(name.endswith(part) for name in files)] == []
    assert {name for name in wheel(copy / CORE) if name.endswith('.py')} <= files.keys()


def test_package_xml_and_setup_py_agree() -> None:
    manifest = ET.parse(ROOT / 'package.xml').getroot()
    assert manifest.get('format') == '3'
    assert manifest.findtext('export/build_type') == 'ament_python'
    fields = 'name', 'version', 'author', 'license'
    stated = run([sys.executable, 'setup.py', *(f'--{field}' for field in fields)], ROOT)
    assert [manifest.findtext(field) for field in fields] == stated.splitlines()[-4:]
    assert manifest.findtext('version') == pfd.__version__


@pytest.mark.filterwarnings('ignore::DeprecationWarning')  # of docutils, in catkin_pkg
def test_the_changelog_is_one_that_a_release_for_ros_reads() -> None:
    changelog = pytest.importorskip('catkin_pkg.changelog')  # comes with colcon-ros
    text = (ROOT / 'CHANGELOG.rst').read_text(encoding='utf-8')
    heading = f'{pfd.__version__} (2026-11-27)'
    text = re.sub(
        '^Forthcoming\n-+$', f'{heading}\n{"-" * len(heading)}', text, flags=re.MULTILINE
    )
    found = changelog.populate_changelog_from_rst(changelog.Changelog('pfd_ros'), text)
    ((version, _, content),) = found.foreach_version()
    assert version == pfd.__version__
    assert 'pfd sim' in str(content[0])
