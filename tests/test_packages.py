"""What every package.xml has to say, so that rosdep and colcon know all that the code imports."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MANIFESTS = sorted([*ROOT.glob('src/*/package.xml'), *ROOT.glob('[bt]*s/package.xml')])
# rosdep's name of each Python package that it knows; the others stand in requirements/.
KEYS = {
    'cv2': 'python3-opencv',
    'hypothesis': 'python3-hypothesis',
    'matplotlib': 'python3-matplotlib',
    'numpy': 'python3-numpy',
    'psutil': 'python3-psutil',
    'pytest': 'python3-pytest',
    'scipy': 'python3-scipy',
    'tqdm': 'python3-tqdm',
    'yaml': 'python3-yaml',
}
OF_ROS = re.compile(r'.*_(msgs|srvs|interfaces)|rclpy|launch|launch_ros')


@cache
def names() -> frozenset[str]:
    """The workspace's own packages."""
    return frozenset(re.search('<name>(.*)</name>', m.read_text())[1] for m in MANIFESTS)  # type: ignore[index]


def imported(folder: Path) -> set[str]:
    modules: set[str] = set()
    for path in folder.rglob('*.py'):
        if path.name == 'setup.py':
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                modules |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                modules.add(node.module)
    return {module.partition('.')[0] for module in modules}


def test_all_packages_are_found() -> None:
    assert {'hoid_bags', 'hoid_msgs', 'hoid_system_tests', 'rgbd_slam'} <= names()


@pytest.mark.parametrize('manifest', MANIFESTS, ids=lambda path: path.parent.name)
def test_dependencies_are_complete(manifest: Path) -> None:
    used = imported(manifest.parent)
    needed = {KEYS.get(name, name) for name in used if name in KEYS or name in names()}
    needed |= {name for name in used if OF_ROS.fullmatch(name)}
    text = manifest.read_text()
    declared = set(re.findall(r'depend>([\w-]+)<', text)) | set(re.findall('<name>(.*)<', text))
    assert needed <= declared


@pytest.mark.parametrize(
    'setup',
    [m.parent / 'setup.py' for m in MANIFESTS if (m.parent / 'setup.py').exists()],
    ids=lambda path: path.parent.name,
)
def test_colcon_finds_the_tests(setup: Path) -> None:
    assert "extras_require={'test': ['pytest']}" in setup.read_text()
