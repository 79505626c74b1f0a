"""The steps of the lane `ros` work: a sourced underlay, colcon, no pytest-xdist.

The underlay is made of ROS's wheels and of the messages that a ROS installation may have, in place
of /opt/ros/jazzy. The packages that pip would install are links to those of this environment, and
compilers do not optimize, because that takes a third of the time. All tests of the packages are
imported, and some are run.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
SITE = Path(sysconfig.get_path('purelib'))
JOBS = yaml.safe_load((ROOT / '.github/workflows/ci.yml').read_text())['jobs']
# pytest-xdist is not part of a ROS installation.
MISSING = ('pytest-xdist',)
# Arguments of pytest for packages in Python; all tests of the kernels run.
SELECTED = ['-m', 'not slow', '-k', 'parameter or strateg']

pytestmark = [pytest.mark.thorough, pytest.mark.alone]


def commands(lane: str) -> dict[str, str]:
    """Return the commands of a lane by the names of their steps."""
    return {step['name']: step['run'] for step in JOBS[lane]['steps'] if 'name' in step}


def is_of_ros(distribution: importlib.metadata.Distribution) -> bool:
    return distribution.metadata['Name'].startswith('ros-')


def make_underlay(prefix: Path) -> None:
    """Copy what ROS's wheels installed into a prefix, and write a `setup.bash` for it."""
    for distribution in filter(is_of_ros, importlib.metadata.distributions(path=[str(SITE)])):
        for file in distribution.files or ():
            source = Path(os.path.normpath(SITE / file))
            target = prefix / source.relative_to(sys.prefix)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target)
    messages = [ROOT / 'install' / path.name for path in (ROOT / 'third_party').iterdir()]
    prefixes = [prefix, *filter(Path.is_dir, messages)]
    site = SITE.relative_to(sys.prefix)
    bundled = (prefix / site).glob('*.libs')  # libraries of the distribution that built a wheel
    paths = {
        'AMENT_PREFIX_PATH': prefixes,
        'LD_LIBRARY_PATH': [*(one / 'lib' for one in prefixes), *bundled],
        'PATH': [prefix / 'bin'],
        'PYTHONPATH': [one / site for one in prefixes],
    }
    lines = ['export ROS_DISTRO=jazzy']
    for name, folders in paths.items():
        text = ':'.join(map(str, folders))
        lines.append(f'export {name}={shlex.quote(text)}${{{name}:+:${name}}}')
    (prefix / 'setup.bash').write_text('\n'.join(lines) + '\n')


def make_environment(workspace: Path) -> None:
    """Make the virtual environment that the launcher would, from links to this one's packages."""
    venv = workspace / '.venv'
    make = ('-m', 'venv', '--without-pip', '--system-site-packages', str(venv))
    subprocess.run([f'{sys.base_prefix}/bin/python3', *make], check=True)
    site = venv / SITE.relative_to(sys.prefix)
    for distribution in importlib.metadata.distributions(path=[str(SITE)]):
        if is_of_ros(distribution) or distribution.metadata['Name'] in MISSING:
            continue
        for top in {Path(file).parts[0] for file in distribution.files or ()} - {'..'}:
            if (SITE / top).exists() and not (site / top).exists():
                (site / top).symlink_to(SITE / top)
    texts = {path.stem: path.read_text() for path in (ROOT / 'requirements').glob('*.lock')}
    texts['robot'] += texts['build']  # one stamp for both
    for name, text in texts.items():
        digest = hashlib.sha256(f'{workspace}\n{text}'.encode()).hexdigest()[:32]
        (venv / f'.hoid-{name}.key').write_text(f'{digest}\n')


@pytest.fixture(scope='module')
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clone without build, next to an underlay `ros`."""
    folder = tmp_path_factory.mktemp('lane')
    workspace = folder / 'clone'
    listed = subprocess.run(
        ['git', 'ls-files', '-z'], cwd=ROOT, check=True, capture_output=True, text=True
    )
    for name in filter(None, listed.stdout.split('\0')):
        target = workspace / name
        if (ROOT / name).exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target)
    make_underlay(folder / 'ros')
    make_environment(workspace)
    for name in ('cc', 'c++'):
        compiler = folder / name
        compiler.write_text(f'#!/bin/bash\nexec /usr/bin/{name} "${{@/#-O[23]/-O0}}"\n')
        compiler.chmod(0o755)
    return workspace


def run_step(workspace: Path, step: str, **more: str) -> str:
    """Run one step of the lane in a shell without ROS, and return what it prints."""
    kept = {name: os.environ[name] for name in ('HOME', 'USER', 'LANG') if name in os.environ}
    command = commands('ros')[step].replace('/opt/ros/jazzy', str(workspace.parent / 'ros'))
    done = subprocess.run(
        ['bash', '--noprofile', '--norc', '-eo', 'pipefail', '-c', command],
        cwd=workspace,
        env={**kept, 'PATH': '/usr/local/bin:/usr/bin:/bin', **more},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f'{step}: {done.stdout[-3000:]}{done.stderr[-3000:]}'
    return done.stdout + done.stderr


@pytest.fixture(scope='module')
def built(workspace: Path) -> str:
    """The output of the step that installs and builds."""
    folder = workspace.parent
    return run_step(workspace, 'Build', CC=str(folder / 'cc'), CXX=str(folder / 'c++'))


# Two tests, because each has ten minutes on a busy machine.
def test_the_lane_with_ros_builds(built: str) -> None:
    assert built.splitlines()[-1] == 'hoid: ready'


@pytest.mark.usefixtures('built')
def test_the_lane_with_ros_tests(workspace: Path) -> None:
    defaults = workspace.parent / 'defaults.yaml'
    defaults.write_text(yaml.safe_dump({'test': {'pytest-args': SELECTED}}))
    said = run_step(workspace, 'Test', COLCON_DEFAULTS_FILE=str(defaults))
    (num_tests,) = re.findall(r'Summary: (\d+) tests, 0 errors, 0 failures', said)
    assert int(num_tests) > 100
