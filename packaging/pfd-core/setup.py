"""The library without ROS, as the distribution pfd-core.

`pfd_core`, `config` and `LICENSE` are links to those of the repository. The distribution pfd-ros,
of the repository's own setup.py, has both packages: install one of the two.
"""

from pathlib import Path
import re

from setuptools import find_packages, setup

SOURCE = Path('pfd_core/__init__.py').read_text(encoding='utf-8')

setup(
    name='pfd-core',
    version=re.findall("^__version__ = '(.*)'$", SOURCE, re.MULTILINE)[0],
    description='Dynamics of robot arms, counted on an emulated SIMD computer and compiled',
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
        'Typing :: Typed',
    ],
    python_requires='>=3.10',
    packages=[*find_packages(include=['pfd_core*']), 'pfd_core.config'],
    package_dir={'pfd_core.config': 'config'},
    package_data={'pfd_core.config': ['robots/*'], 'pfd_core': ['py.typed']},
    zip_safe=False,
    install_requires=['numpy', 'llvmlite>=0.45', 'PyYAML', 'xacro'],
    extras_require={'report': ['matplotlib', 'mpmath'], 'mjcf': ['mujoco>=3.17']},
)
