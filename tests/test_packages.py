"""Every package.xml and setup.py declares all that the code imports."""

import ast
import re
import sys
from functools import cache
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

ROOT = Path(__file__).parents[1]
MANIFESTS = sorted([*ROOT.glob('src/*/package.xml'), *ROOT.glob('[bt]*s/package.xml')])
SETUPS = [m.parent / 'setup.py' for m in MANIFESTS if (m.parent / 'setup.py').exists()]
# rosdep keys of Python modules.
KEYS = {
    'argcomplete': 'python3-argcomplete',
    'cv2': 'python3-opencv',
    'gtsam': 'gtsam',
    'hypothesis': 'python3-hypothesis',
    'lz4': 'python3-lz4',
    'numpy': 'python3-numpy',
    'onnxruntime': 'python3-onnxruntime-pip',
    'psutil': 'python3-psutil',
    'pytest': 'python3-pytest',
    'rosbags': 'python3-rosbags-pip',
    'scipy': 'python3-scipy',
    'tqdm': 'python3-tqdm',
    'yaml': 'python3-yaml',
}
# Names of distributions on PyPI that differ from the module's name.
DISTRIBUTIONS = {
    'backports': 'backports-zstd',
    'cv2': 'opencv-python-headless',
    'mcap_ros2': 'mcap-ros2-support',
    'rerun': 'rerun-sdk',
    'skimage': 'scikit-image',
    'yaml': 'pyyaml',
}
# In the source tree only; tests use them, no package depends on them.
LABORATORY = {path.parent.name for path in ROOT.glob('lab/*/__init__.py')}
OF_ROS = re.compile(r'.*_(msgs|srvs|interfaces)|rclpy|launch|launch_ros')


def element(manifest: Path, tag: str) -> str | None:
    """Return the text of an element of a package.xml."""
    return ET.parse(manifest).findtext(tag)  # noqa: S314  # our own file


@cache
def names() -> frozenset[str]:
    """Return the names of the packages of the workspace."""
    return frozenset(element(manifest, 'name') or '' for manifest in MANIFESTS)


def imported(folder: Path) -> set[str]:
    """Return the top-level modules that the Python files of a folder import."""
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


@pytest.mark.parametrize('setup', SETUPS, ids=lambda path: path.parent.name)
def test_setup_names_every_python_package(setup: Path) -> None:
    declared = requirements(setup)
    own = {path.stem for path in setup.parent.glob('test/*.py')}  # helpers of the tests
    foreign = {
        DISTRIBUTIONS.get(name, name)
        for name in imported(setup.parent)
        if name not in names() | own | sys.stdlib_module_names and not OF_ROS.fullmatch(name)
    }
    foreign -= {'ament_index_python', 'rosidl_runtime_py', 'setuptools', *LABORATORY}
    assert foreign - {'hypothesis', 'playwright'} <= declared
    assert declared - {'hypothesis', 'pytest'} <= foreign


@pytest.mark.parametrize('setup', SETUPS, ids=lambda path: path.parent.name)
def test_colcon_finds_the_tests(setup: Path) -> None:
    assert re.search(r"extras_require=\{\s*'test': \[[^]]*'pytest'", setup.read_text())


def requirements(setup: Path) -> set[str]:
    """Return the distributions that a setup.py requires, extras included."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(setup.read_text())):
        if isinstance(node, ast.keyword) and node.arg in ('install_requires', 'extras_require'):
            value = ast.literal_eval(node.value)
            lists = value.values() if isinstance(value, dict) else [value]
            found |= {name for names in lists for name in names}
    return found


@pytest.mark.parametrize('setup', SETUPS, ids=lambda path: path.parent.name)
def test_setup_and_manifest_agree(setup: Path) -> None:
    declared = dict(re.findall(r"^    (\w+)='(.*)',$", setup.read_text(), re.MULTILINE))
    declared |= dict(re.findall(r"^(NAME) = '(.*)'$", setup.read_text(), re.MULTILINE))
    manifest = setup.with_name('package.xml')
    assert declared['NAME'] == element(manifest, 'name')
    for name in ('version', 'description', 'maintainer', 'license'):
        assert declared[name] == element(manifest, name)
    assert f'email="{declared["maintainer_email"]}"' in manifest.read_text()


@pytest.mark.parametrize('manifest', MANIFESTS, ids=lambda path: path.parent.name)
def test_all_packages_have_one_version_and_the_license_at_the_root(manifest: Path) -> None:
    assert element(manifest, 'version') == element(MANIFESTS[0], 'version')
    assert element(manifest, 'license') == 'Apache-2.0'
    assert (ROOT / 'LICENSE').read_text().split()[:4] == ['Apache', 'License', 'Version', '2.0,']
