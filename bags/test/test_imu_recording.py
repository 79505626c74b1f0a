"""Samples of an IMU are read from text files and from topics of a bag."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.imu_recording import (
    ImuRecording,
    joined_imu,
    read_imu,
    read_imu_file,
    read_imu_topic,
    read_own_imu,
)
from hoid_bags.storage.bag_types import IMU
from hoid_common.errors import InputError
from hoid_common.values import NS_PER_S


def written(folder: Path, name: str, text: str) -> Path:
    """Return the path of a text file."""
    path = folder / name
    path.write_text(text, encoding='utf-8')
    return path


@pytest.mark.parametrize(
    ('name', 'head'),
    [('gyro.txt', ''), ('imu.txt', '# timestamp wx wy wz\n'), ('imu.txt', '')],
)
def test_three_columns_are_rates(tmp_path: Path, name: str, head: str) -> None:
    found = read_imu_file(written(tmp_path, name, f'{head}1.0 0.1 0.2 0.3\n1.005 0.4 0.5 0.6\n'))
    assert found.accelerations is None
    assert found.rates is not None
    assert found.rates.stamps_ns.tolist() == [NS_PER_S, NS_PER_S + 5_000_000]
    np.testing.assert_array_equal(found.rates.values, [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])


@pytest.mark.parametrize(
    ('name', 'head'),
    [('accelerometer.txt', ''), ('imu.txt', '# timestamp ax ay az\n'), ('imu.txt', '')],
)
def test_three_columns_are_accelerations(tmp_path: Path, name: str, head: str) -> None:
    found = read_imu_file(written(tmp_path, name, f'{head}1.0 0.1 9.7 0.3\n1.01 0.4 9.6 0.6\n'))
    assert found.rates is None
    assert found.accelerations is not None
    np.testing.assert_array_equal(found.accelerations.values[0], [0.1, 9.7, 0.3])


def test_six_columns_are_rates_and_accelerations(tmp_path: Path) -> None:
    found = read_imu_file(written(tmp_path, 'imu.csv', '1.0,1,2,3,4,5,6\n'))
    assert found.rates is not None
    assert found.accelerations is not None
    np.testing.assert_array_equal(found.rates.values, [[1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(found.accelerations.values, [[4.0, 5.0, 6.0]])


def test_numbers_that_are_not_finite_are_left_to_who_counts_them(tmp_path: Path) -> None:
    text = '1.0 0.1 0.2 0.3 0 0 nan\n2.0 0 0 0 0 0 9.8\n'
    found = read_imu_file(written(tmp_path, 'imu.txt', text))
    assert found.rates is not None
    assert found.accelerations is not None
    assert len(found.rates.stamps_ns) == len(found.accelerations.stamps_ns) == 2
    np.testing.assert_array_equal(found.accelerations.values[:, 2], [np.nan, 9.8])
    huge = written(tmp_path, 'other.txt', '1.0 1e300 0 0\n2.0 0.1 9.7 0.3\n3.0 0.1 9.8 0.3\n')
    assert read_imu_file(huge).rates is None


@pytest.mark.parametrize('text', ['', '# nothing\n', '1.0 0.1 0.2\n', '1.0 a b c\n'])
def test_a_file_without_samples_is_refused_by_its_name(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r'imu\.txt: '):
        read_imu_file(written(tmp_path, 'imu.txt', text))


def test_two_files_join_to_one_recording(tmp_path: Path) -> None:
    gyro = read_imu_file(written(tmp_path, 'gyro.txt', '1.0 0.1 0.2 0.3\n'))
    both = gyro.joined(read_imu_file(written(tmp_path, 'accel.txt', '1.0 0.1 9.7 0.3\n')))
    assert both.rates is gyro.rates
    assert both.accelerations is not None
    assert ImuRecording().joined(both) == both


def test_a_topic_with_two_sensors_in_turn_is_read(tmp_path: Path) -> None:
    bag = tmp_path / 'bag'
    with BagWriter(bag) as writer:
        writer.add_topic('/imu', IMU)
        writer.add_topic('/other', IMU)
        for k in range(3):
            rate, force = np.array([0.1 * k, 0.0, 1.0]), np.array([0.0, 9.8, k])
            writer.write('/imu', 2 * k + 1, bag_messages.imu(2 * k + 1, rate_radps=rate))
            writer.write('/imu', 2 * k + 2, bag_messages.imu(2 * k + 2, force))
    found = read_imu('imu', bag)
    assert found.rates is not None
    assert found.accelerations is not None
    assert found.rates.stamps_ns.tolist() == [1, 3, 5]
    assert found.accelerations.stamps_ns.tolist() == [2, 4, 6]
    np.testing.assert_allclose(found.rates.values[:, 0], [0.0, 0.1, 0.2])
    np.testing.assert_allclose(found.accelerations.values[:, 2], [0.0, 1.0, 2.0])
    with pytest.raises(InputError, match='no topic /gyro of sensor_msgs/msg/Imu; it has /imu'):
        read_imu_topic(bag, 'gyro')
    with pytest.raises(InputError, match='/other has no rates and no accelerations'):
        read_imu_topic(bag, '/other')


def test_a_recording_has_an_imu_of_its_own(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='has no samples of an IMU'):
        read_own_imu(tmp_path)
    written(tmp_path, 'gyro.txt', '1.0 0.1 0.2 0.3\n')
    written(tmp_path, 'accelerometer.txt', '1.0 0.1 9.7 0.3\n')
    of_folder = read_own_imu(tmp_path)
    bag = tmp_path / 'bag'
    with BagWriter(bag) as writer:
        for topic, message in {
            '/imu': bag_messages.imu(NS_PER_S, rate_radps=np.array([0.1, 0.2, 0.3])),
            '/imu/accelerometer': bag_messages.imu(NS_PER_S, np.array([0.1, 9.7, 0.3])),
        }.items():
            writer.add_topic(topic, IMU)
            writer.write(topic, NS_PER_S, message)
    for found in of_folder, read_own_imu(bag):
        assert found.rates is not None
        assert found.accelerations is not None
        np.testing.assert_array_equal(found.rates.values, [[0.1, 0.2, 0.3]])
        np.testing.assert_array_equal(found.accelerations.values, [[0.1, 9.7, 0.3]])


def test_a_sensor_whose_values_are_all_zero_is_missing(tmp_path: Path) -> None:
    """As in the SLAM node: drivers that publish the sensors apart leave the other one zero."""
    bag, zeros = tmp_path / 'bag', np.zeros(3)
    with BagWriter(bag) as writer:
        writer.add_topic('/imu', IMU)
        for k in range(3):
            rate, force = np.array([0.1, 0.0, 1.0]), np.array([0.0, 9.8, 0.1])
            writer.write('/imu', 2 * k + 1, bag_messages.imu(2 * k + 1, zeros, rate_radps=rate))
            writer.write('/imu', 2 * k + 2, bag_messages.imu(2 * k + 2, force, rate_radps=zeros))
    found = read_imu('imu', bag)
    assert found.rates is not None
    assert found.accelerations is not None
    assert found.rates.stamps_ns.tolist() == [1, 3, 5]
    assert found.accelerations.stamps_ns.tolist() == [2, 4, 6]


NUM_SAMPLES, IMU_PERIOD_NS = 40, 5_000_000


def rate_at(i: float) -> list[float]:
    return [0.01 * i, -0.02 * i - 0.1, 0.3]


def force_at(i: float) -> list[float]:
    return [0.1, 0.02 * i, 9.8]


def driver_messages(method: str) -> dict[str, list[tuple[float, Any]]]:
    """Return the messages by topic, with their numbers, as realsense2_camera publishes an IMU.

    The gyro has every number, the accelerometer every other one. With `unite_imu_method` 1 (copy),
    each message has the newest value of the other sensor; with 2 (linear), an interpolated one.
    """
    imu, accel, gyro = '/camera/imu', '/camera/accel/sample', '/camera/gyro/sample'
    found: dict[str, list[tuple[float, Any]]] = {}
    for i in range(NUM_SAMPLES):
        ns = NS_PER_S + i * IMU_PERIOD_NS
        rate = np.array(rate_at(i))
        if method == 'none':
            found.setdefault(gyro, []).append((i, bag_messages.imu(ns, None, rate)))
            if i % 2 == 0:
                found.setdefault(accel, []).append(
                    (i, bag_messages.imu(ns, np.array(force_at(i))))
                )
            continue
        force = np.array(force_at(i if method == 'linear' else i - i % 2))
        message = bag_messages.imu(ns, force, rate)
        if method == 'no covariance':
            message.orientation_covariance[:] = 0
        found.setdefault(imu, []).append((i, message))
    return found


@pytest.mark.parametrize('method', ['none', 'copy', 'linear', 'no covariance'])
def test_an_imu_as_drivers_publish_it(method: str, tmp_path: Path) -> None:
    found = driver_messages(method)
    with BagWriter(tmp_path / 'bag') as writer:
        for topic in found:
            writer.add_topic(topic, IMU)
        for topic, messages in found.items():
            for i, message in messages:
                writer.write(topic, int(i), message)
    imu = joined_imu(list(found), tmp_path / 'bag')
    assert imu.rates is not None
    assert imu.accelerations is not None
    np.testing.assert_allclose(imu.rates.values, [rate_at(i) for i in range(NUM_SAMPLES)])
    numbers = (imu.accelerations.stamps_ns - NS_PER_S) / IMU_PERIOD_NS
    assert len(numbers) == (NUM_SAMPLES // 2 if method == 'none' else NUM_SAMPLES)
    for number, force in zip(numbers, imu.accelerations.values, strict=True):
        taken_at = number - number % 2 if method in ('copy', 'no covariance') else number
        np.testing.assert_allclose(force, force_at(taken_at))
