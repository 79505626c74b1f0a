"""The files of a public project are well formed, and name real commands and the version."""

from __future__ import annotations

import json
import os
import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
import yaml

from hoid_bringup.cli import COMMANDS, argument_parser

ROOT = Path(__file__).parents[1]
VERSION = ET.parse(ROOT / 'src/rgbd_slam/package.xml').findtext('version')  # noqa: S314  # ours
YAML_FILES = ('.github/workflows/ci.yml', '.pre-commit-config.yaml', 'CITATION.cff', 'mkdocs.yml')


@pytest.mark.parametrize('name', YAML_FILES)
def test_yaml_is_well_formed(name: str) -> None:
    assert yaml.safe_load((ROOT / name).read_text())


def test_make_targets_that_documents_name_exist() -> None:
    targets = set(re.findall(r'^([\w-]+):', (ROOT / 'Makefile').read_text(), re.MULTILINE))
    for name in ('CONTRIBUTING.md', 'README.md', '.github/workflows/ci.yml', '.ci/run'):
        text = (ROOT / name).read_text()
        named = re.findall(r'(?:`|run: |^)make ([\w-]+)', text, re.MULTILINE)
        assert named, name
        assert set(named) <= targets, name


def test_citation_and_changelog_name_the_version_and_the_paper() -> None:
    citation = yaml.safe_load((ROOT / 'CITATION.cff').read_text())
    assert citation['version'] == VERSION
    assert citation['references'][0]['doi'] == '10.1177/17298806241279782'
    released = f'## {VERSION} - {citation["date-released"]}\n'
    assert released in (ROOT / 'CHANGELOG.md').read_text()
    assert citation['title'].startswith('HOID RGB-D SLAM')


def test_lane_image_and_devcontainer_take_the_same_steps_on_the_same_ros() -> None:
    container = json.loads((ROOT / '.devcontainer/devcontainer.json').read_text())
    lanes = yaml.safe_load((ROOT / '.github/workflows/ci.yml').read_text())['jobs']
    image = (ROOT / 'Dockerfile').read_text()
    assert f'FROM {container["image"]}\n' in image
    assert lanes['ros']['container'] == container['image']
    packages = '.ci/ros_packages'
    assert container['onCreateCommand'] == packages
    assert f'RUN {packages} ' in image
    assert packages in [step.get('run') for step in lanes['ros']['steps']]
    for text in (image, container['postCreateCommand'], str(lanes['ros'])):
        assert '/opt/ros/jazzy/setup.' in text
        assert './hoid ' in text


def test_readme_image_and_workflow_install_the_same_packages() -> None:
    def installed(path: str) -> list[set[str]]:
        text = (ROOT / path).read_text().replace('\\\n', '')
        found = re.findall(r'apt(?:-get)? install (?:-\S+ )*([^\n&]+)', text)
        return [set(names.split()) for names in found]

    (documented,) = installed('README.md')
    (extra,) = re.findall(r'\(add `(\S+)` above\)', (ROOT / 'README.md').read_text())
    assert installed('.ci/ros_packages') == [documented | {extra}]
    assert documented in installed('.github/workflows/ci.yml')


def test_the_image_runs_the_documented_docker_commands() -> None:
    page_name = 'docs/howto/another_camera.md'
    page, image = ((ROOT / name).read_text() for name in (page_name, 'Dockerfile'))
    assert page_name in image
    build, run = re.findall(r'^(docker (?:build|run) .+)$', page, re.MULTILINE)
    tag = build.split()[3]
    words = run.partition(f' {tag} ')[2].split()
    assert 'realsense' in vars(argument_parser(words[0]).parse_args(words)).values()
    assert 'exec ./hoid \\"$@\\""' in image
    assert 'RUN . /opt/ros/jazzy/setup.sh && ./hoid setup\n' in image


@pytest.mark.parametrize('name', ['bug_report.md', 'feature_request.md'])
def test_issue_templates_have_a_name_and_a_purpose(name: str) -> None:
    text = (ROOT / '.github/ISSUE_TEMPLATE' / name).read_text()
    header = yaml.safe_load(text.split('---')[1])
    assert header['name']
    assert header['about']


def test_a_long_set_up_names_the_package_at_work(tmp_path: Path) -> None:
    text = (ROOT / 'hoid').read_text()
    functions = text[text.index('newest_package() {') : text.index('usable_python() {')]
    script = f"""
log={tmp_path}/log; say() {{ echo "hoid: $*"; }}; die() {{ say "$*"; exit 1; }}
{functions.replace('sleep 10', 'sleep 0.5')}
job() {{ echo 'Collecting numpy==2 (from x)'; echo 'Starting >>> hoid_native'; sleep 0.8; }}
pip() {{ job; echo 'Installing collected packages: a, b'; sleep 0.8; }}
run_logged 'building' job; run_logged 'installing' pip; run_logged 'failing' false
"""
    done = subprocess.run(['bash', '-c', script], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    lines = done.stdout.splitlines()
    assert re.fullmatch(r'hoid: building: \d s, package 2 \(hoid_native\)', lines[1])
    assert re.fullmatch(r'hoid: building: done in \d s', lines[2])
    assert re.fullmatch(r'hoid: installing: \d s, installing 2 packages', lines[5])
    assert lines[-1] == f'hoid: failing failed; see the log {tmp_path}/log'


def launched(words: str, tmp_path: Path, machine: str, **environment: str) -> tuple[int, str]:
    """Return status and output of the launcher on a machine of this processor."""
    uname = tmp_path / 'uname'
    uname.write_text(f'#!/bin/sh\necho {machine}\n')
    uname.chmod(0o755)
    kept = {k: v for k, v in os.environ.items() if k not in ('ROS_DISTRO', 'PATH')}
    path = f'{tmp_path}:/usr/bin:/bin'
    done = subprocess.run(
        [ROOT / 'hoid', *words.split()],
        env={**kept, **environment, 'PATH': path},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    return done.returncode, done.stdout + done.stderr


def test_on_arm_the_launcher_asks_for_an_installed_ros(tmp_path: Path) -> None:
    status, said = launched('status', tmp_path, 'aarch64')
    assert status == 1
    assert 'for x86-64 only, this is aarch64: install ROS 2 Jazzy' in said
    assert len(said.splitlines()) == 1
    status, said = launched('synth a.bag', tmp_path, 'aarch64', ROS_DISTRO='jazzy')
    assert (status, said) == (1, 'hoid: synth needs a renderer whose wheels are for x86-64 only\n')


def test_the_launcher_names_its_commands_where_there_is_no_ros2(tmp_path: Path) -> None:
    status, said = launched('env ros2 topic list', tmp_path, 'x86_64')
    assert status == 1
    assert said.startswith('hoid: ROS 2 is not installed here; use ./hoid nodes, status, ')
    named = set(re.findall(r'[\w-]+', said.partition('./hoid ')[2].partition(' (')[0]))
    assert named - {'or', 'view'} <= {*COMMANDS}
