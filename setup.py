"""The ament_python package: metadata, and what goes where under the install prefix."""

from glob import glob

from setuptools import find_packages, setup

NAME = "epos2_ros"
SHARE = f"share/{NAME}"

EXAMPLES = [file for kind in ("service", "xml", "yaml") for file in glob(f"examples/*.{kind}")]
PLANNERS = ["ruckig", "toppra"]  # for fresh trajectories

setup(
    name=NAME,
    version="0.1.0",
    description="ROS 2 driver for synchronised motion of several axes with maxon EPOS2 drives",
    license="Apache-2.0",
    maintainer="epos2_ros maintainers",
    maintainer_email="maintainers@epos2-ros.example",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["commission/*.csv", "eds/*.eds", "py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (SHARE, ["package.xml"]),
        (f"{SHARE}/config", glob("config/*.yaml") + glob("config/*.rviz")),
        (f"{SHARE}/examples", EXAMPLES),
        (f"{SHARE}/examples/moveit", glob("examples/moveit/*")),
        (f"{SHARE}/launch", glob("launch/*.launch.py")),
        (f"lib/{NAME}", glob("scripts/*")),  # where `ros2 run` looks
    ],
    entry_points={"console_scripts": [f"{NAME} = {NAME}.__main__:main"]},
    python_requires=">=3.10",
    install_requires=[
        "canopen~=2.4",
        "matplotlib",
        "numba",  # optional: without it the records are the same, but take much longer
        "numpy",
        "python-can[multicast,serial]~=4.5",
        "pyyaml",
        "rich",  # optional: for the program `monitor` alone
    ],
    extras_require={
        # ROS 2 Jazzy from PyPI, for a machine without a ROS installation
        "ros": ["ros-jazzy-common-interfaces", "ros-jazzy-rclpy", "ros-jazzy-rmw-fastrtps-cpp"],
        "bench": PLANNERS,
        "test": [
            "colcon-common-extensions",
            "hypothesis",
            "mypy",
            "pytest",
            "pytest-timeout",
            "pytest-xdist",
            *PLANNERS,
            "ruff",
            "setuptools>=70.1",  # builds wheels by itself
            "types-PyYAML",
        ],
    },
    zip_safe=False,
)
