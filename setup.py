"""Both packages as the distribution pfd-ros: for pip, colcon (ament_python) and the `pfd` command.

packaging/pfd-core describes the library alone. The version is stated in pfd_core and, for ROS, in
package.xml.
"""

from glob import glob
from pathlib import Path
import re

from setuptools import find_packages, setup

NAME = 'pfd_ros'
LIBRARY = Path('pfd_core/__init__.py').read_text(encoding='utf-8')
ROBOTS = glob('config/robots/*')
ROS = ['ros-jazzy-rclpy', 'ros-jazzy-common-interfaces', 'ros-jazzy-rmw-fastrtps-cpp']
REPORT = ['matplotlib', 'mpmath']
# Robots of MuJoCo.
MJCF = ['mujoco>=3.17']
# Peers of benchmarks other than Pinocchio, Eigen's headers for its C++, and public arms.
PEERS = ['casadi', *MJCF, 'dynibo', 'cmeel-eigen', 'example-robot-data']
# Completion of `pfd` in shells, as ros2 and colcon have it.
COMPLETION = ['argcomplete']
# The 3D view: its page, and meshes of URDFs (COLLADA through pycollada).
VIEW = ['viser>=1.1', 'trimesh>=4', 'pycollada']
# The documentation site. Its pages are Markdown, and its reference is made from docstrings.
DOCS = ['sphinx>=8.1', 'myst-parser>=4', 'furo']

setup(
    name=NAME,
    version=re.findall("^__version__ = '(.*)'$", LIBRARY, re.MULTILINE)[0],
    description='A simulated robot arm for testing torque controllers',
    long_description=Path('README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    author='The pfd_ros authors',
    maintainer='The pfd_ros authors',
    maintainer_email='maintainers@example.com',
    license='Apache-2.0',
    classifiers=[
        'Development Status :: 4 - Beta',
        'Intended Audience :: Science/Research',
        'Operating System :: POSIX :: Linux',
        'Programming Language :: Python :: 3',
        'Topic :: Scientific/Engineering',
        'Topic :: Software Development :: Testing',
        'Typing :: Typed',
    ],
    python_requires='>=3.10',
    packages=[*find_packages(include=['pfd_core*', 'pfd_ros*']), 'pfd_core.config'],
    # The robots and the node's parameters travel inside the package, so that they are found
    # whichever way it was installed.
    package_dir={'pfd_core.config': 'config'},
    package_data={
        'pfd_core.config': ['*.yaml', 'robots/*'],
        'pfd_core': ['py.typed'],
        'pfd_ros': ['py.typed'],
        'pfd_ros.page': ['assets/*'],
        'pfd_ros.starter': ['templates/**/*.in'],
        'pfd_ros.testing': ['*.xml'],
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', glob('config/*.yaml')),
        (f'share/{NAME}/config/robots', ROBOTS),
        (f'share/{NAME}/launch', glob('launch/*.launch.py')),
    ],
    zip_safe=False,
    install_requires=[
        *('numpy', 'pin', 'mcap>=1.6', 'llvmlite>=0.45', 'PyYAML', 'rosbags>=0.11.9'),
        # Most vendors publish their arm as xacro.
        'xacro',
    ],
    extras_require={
        # Not in install_requires: on a machine with its own ROS 2 these wheels would lie over it.
        'ros': ROS,
        'report': REPORT,
        'mjcf': MJCF,
        'peers': PEERS,
        'view': VIEW,
        'completion': COMPLETION,
        'docs': DOCS,
        'test': [
            *REPORT,
            *PEERS,
            *COMPLETION,
            *DOCS,
            *VIEW,
            'colcon-common-extensions',
            'colcon-ros',
            'hypothesis',
            'mcap-ros2-support',
            'mypy',
            'pytest',
            'pytest-timeout',
            'pytest-xdist',
            'ruff',
            'scipy',
        ],
    },
    entry_points={
        'console_scripts': [
            'pfd = pfd_ros.cli.main:main',
            'sim_node = pfd_ros.node.main:main',
        ],
        'pytest11': ['pfd_ros = pfd_ros.testing.plugin'],
    },
)
