"""Install rules of the ROS package; the code is the import package of the same name, three folders up."""

from setuptools import find_packages, setup

NAME = "softsim_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={"": ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},  # by which colcon knows what runs the tests
    zip_safe=False,
    maintainer="the softsim authors",
    maintainer_email="softsim@users.noreply.example.org",
    description="ROS 2 nodes of the soft-robot simulator: simulator, teleop, and the softsim command line.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "closed_loop = softsim_ros.inverse.closed_loop_node:main",
            "inverse_controller = softsim_ros.inverse.inverse_node:main",
            "path_follower = softsim_ros.inverse.path_follower_node:main",
            "recorder = softsim_ros.recording.recorder_node:main",
            "simulator = softsim_ros.simulator.simulator_node:main",
            "softsim = softsim_ros.cli:main",
            "teleop = softsim_ros.teleop.teleop_node:main",
            "viewer = softsim_ros.viewer.viewer_node:main",
        ],
    },
)
