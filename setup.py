"""Build metadata of mbd_sim_ros: one description for pip and for colcon (ament_python)."""

from collections import defaultdict
from fnmatch import fnmatchcase
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py

NAME = 'mbd_sim_ros'
SHARE = f'share/{NAME}'
ROOT = Path(__file__).parent
# What compiles kernels, computes, and writes recordings: from the oldest to the newest versions that have been tested,
# for the cache of kernels uses private parts of numba, and the bits have to stay. Continuous integration runs both ends
# (.ci/ends).
COMPILED_WITH = [
    'numba>=0.58.1,<0.69',
    'llvmlite>=0.41.1,<0.51',
    'numpy>=1.26.0,<2.5',
    'scipy>=1.11.1,<1.18',
    'mcap>=1.5.0,<1.7',
]

# What users run of the lab. The rest proves the program to itself (studies of the method, random mechanisms, published
# results): it stays in the source tree, where `make setup` runs it. A module of the lab that is new is not installed
# unless it is named here.
LAB = (
    '__init__',
    'benchmarks.*',
    'peers.*',
    *(f'studies.{name}' for name in ('__init__', 'report', 'trade', 'trade_report')),
)


class Installed(build_py):
    """Builds all modules but those of the lab that users do not run."""

    def find_package_modules(self, package, package_dir):
        found = super().find_package_modules(package, package_dir)
        return [one for one in found if is_installed(f'{one[0]}.{one[1]}')]


def is_installed(module: str) -> bool:
    """Whether a module, by its dotted name, is part of what is installed."""
    inside = module.removeprefix(f'{NAME}.lab.')
    return inside == module or any(fnmatchcase(inside, pattern) for pattern in LAB)


def data_files() -> list[tuple[str, list[str]]]:
    """Scene data, launch files and documents go to share/, with their directories; colcon needs paths relative to this
    file."""
    files = defaultdict(list)
    files['share/ament_index/resource_index/packages'].append(f'resource/{NAME}')
    files[SHARE] += ['package.xml', 'README.md', 'CHANGELOG.rst']
    files[f'{SHARE}/bags'] += [f'bags/{name}' for name in ('README.md', 'real_car.py', 'real_car.yaml', 'limits.yaml')]
    for directory in ('config', 'launch', 'docs', 'bags/step_steer', 'bags/real_car'):
        for path in sorted((ROOT / directory).rglob('*')):
            relative = path.relative_to(ROOT)
            if path.is_file() and not any(part.startswith(('.', '__')) for part in relative.parts):
                files[f'{SHARE}/{relative.parent}'].append(str(relative))
    return sorted(files.items())


setup(
    name=NAME,
    version='0.2.0',
    description='Real-time multibody simulation of a detailed road vehicle with an augmented-Lagrangian integrator',
    long_description=(ROOT / 'README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    license='Apache-2.0',
    maintainer='mbd_sim_ros maintainers',
    maintainer_email='maintainers@example.org',
    python_requires='>=3.11',
    packages=find_packages(include=['solver', 'solver.*', NAME, f'{NAME}.*'], exclude=[f'{NAME}.lab.mechanisms']),
    cmdclass={'build_py': Installed},
    package_data={
        'solver': ['py.typed', 'shipped/*'],
        NAME: ['py.typed'],
        f'{NAME}.native': ['*.c', '*.h', '*.inc'],
        f'{NAME}.messages': ['schemas/*/*.msg'],
        f'{NAME}.analysis': ['page.html', 'page.css', 'page.js', 'base.js'],
        f'{NAME}.analysis.third_party.uplot': ['*.js', '*.css', 'LICENSE'],  # draws the curves of pages, MIT
        f'{NAME}.analysis.view': ['view.js', 'scene.js'],
        f'{NAME}.analysis.third_party.three': ['three.min.js', 'LICENSE'],
        f'{NAME}.drive': ['drive.html'],
    },
    data_files=data_files(),
    zip_safe=False,
    install_requires=[*COMPILED_WITH, 'pyyaml', 'matplotlib', 'tqdm', 'argcomplete', 'websockets>=14.0,<18'],
    extras_require={
        # Genuine ROS 2 Jazzy wheels, for machines without ROS. Where Jazzy is installed its own rclpy is used instead.
        'ros': ['ros-rclpy[fastrtps]==7.1.6', 'ros-jazzy-common-interfaces', 'ros-jazzy-rmw-fastrtps-cpp'],
        # The integrators reference_bdf, reference_radau (scipy_dae) and reference_ida (SUNDIALS).
        'references': ['scipy_dae', 'scikit-sundae'],
        # Recordings as pandas DataFrames or xarray Datasets (mbd_sim_ros.analysis.load) and Parquet files (mbd export
        # --parquet).
        'analysis': ['pandas', 'pyarrow', 'xarray'],
        # MDF measurements (.mf4) and CAN logs (.blf, .asc) in mbd compare and mbd evaluate.
        'loggers': ['asammdf', 'python-can'],
        # Recordings of `ros2 bag record` in SQLite (.db3, the default until Humble), and types that are defined in IDL.
        'rosbag2': ['rosbags'],
        # Designs and indices of sensitivity (mbd sweep); sweeps on a Dask cluster.
        'sweep': ['SALib', 'pyarrow'],
        'cluster': ['distributed'],
        # ffmpeg, for films in MP4 (mbd view) where the system has none.
        'video': ['imageio-ffmpeg'],
        # The viewer of `mbd view --rerun` and files for it: 170 MB to fetch, 500 MB installed; of the other extras only
        # `test` has it.
        'rerun': ['rerun-sdk'],
        # The peers of `mbd study work_precision` (exudyn) and `mbd bench`.
        'bench': ['exudyn', 'mujoco'],
        # colcon reads package.xml with catkin_pkg; setuptools 80 dropped what `colcon build --symlink-install` calls.
        'test': [
            'pytest',
            'pytest-xdist',
            'jsonschema',
            'rosbags',
            'pycrg',
            'asammdf',
            'python-can',
            'rerun-sdk',
            'imageio-ffmpeg',
            'SALib',
            'distributed',
            'fmpy',
            'gymnasium',
            'control',
            'pandas',
            'pyarrow',
            'xarray',
            'nbclient',
            'nbformat',
            'ipykernel',
            'scipy_dae',
            'scikit-sundae',
            'setuptools<80',
            'wheel',
            'colcon-core',
            'colcon-bash',
            'colcon-ros',
            'colcon-python-setup-py',
            'colcon-recursive-crawl',
        ],
        # Environments to learn driving in (mbd_sim_ros.learn).
        'learn': ['gymnasium'],
        # Design of controllers on linear models, in the examples of the documents.
        'control': ['control'],
        # Units of co-simulation as controllers in a scene.
        'fmu': ['fmpy'],
        # The documents as a static site (make site).
        'site': ['sphinx', 'myst-parser', 'furo'],
        'dev': ['ruff', 'mypy', 'import-linter', 'types-PyYAML', 'types-tqdm'],
    },
    entry_points={
        'console_scripts': [
            f'simulator = {NAME}.node.main:main',
            f'maneuver = {NAME}.node.maneuver_player:main',
            f'adapter = {NAME}.node.adapter:main',
            f'mbd = {NAME}.commands.main:main',
        ],
        'solver.recordings': [f'mcap = {NAME}.bags.inputs:recorded_inputs'],
    },
)
