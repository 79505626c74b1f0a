from setuptools import find_packages, setup

NAME = 'hoid_system_tests'

setup(
    name=NAME,
    version='0.3.0',
    description='Topic-level, replay and fault tests of the HOID suite',
    maintainer='HOID RGB-D SLAM maintainers',
    maintainer_email='hoid-rgbd-slam@users.noreply.github.com',
    license='Apache-2.0',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['*.cpp']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
    ],
    install_requires=['numpy', 'opencv-python-headless', 'psutil', 'pyyaml'],
    # Without pytest here `colcon test` runs no test at all.
    extras_require={'test': ['hypothesis', 'pytest']},
    zip_safe=True,
)
