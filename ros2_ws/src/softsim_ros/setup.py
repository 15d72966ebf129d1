"""Install rules of the ROS package; the code is the import package of the same name, three folders up."""

from setuptools import find_packages, setup

NAME = "softsim_ros"

setup(
    name=NAME,
    version="0.2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={"": ["py.typed"], NAME: ["templates/*"]},
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
            "closed_loop = softsim_ros.executables:closed_loop",
            "inverse_controller = softsim_ros.executables:inverse_controller",
            "observer = softsim_ros.executables:observer",
            "path_follower = softsim_ros.executables:path_follower",
            "policy = softsim_ros.executables:policy",
            "recorder = softsim_ros.executables:recorder",
            "simulator = softsim_ros.executables:simulator",
            "softsim = softsim_ros.cli:main",
            "teleop = softsim_ros.executables:teleop",
            "viewer = softsim_ros.executables:viewer",
        ],
    },
)
