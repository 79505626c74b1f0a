from glob import glob

from setuptools import find_packages, setup

NAME = 'hoid_common'

setup(
    name=NAME,
    version='0.3.0',
    description='What the HOID packages share: values, geometry, configuration, ROS seam',
    maintainer='HOID RGB-D SLAM maintainers',
    maintainer_email='hoid-rgbd-slam@users.noreply.github.com',
    license='Apache-2.0',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', glob('config/*.xml')),
    ],
    install_requires=['backports-zstd', 'numpy', 'opencv-python-headless', 'pyyaml', 'rosbags'],
    # Without pytest here `colcon test` runs no test at all.
    extras_require={'test': ['hypothesis', 'pytest']},
    zip_safe=True,
)
