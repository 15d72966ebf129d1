"""Install rules of the ROS package: launch files, files for other programs, the configs three folders up."""

from pathlib import Path

from setuptools import setup

NAME = "softsim_bringup"


def installed(folder: str) -> list[tuple[str, list[str]]]:
    """Return pairs of share folder and files for everything below `folder`, in the folder's structure."""
    files: dict[str, list[str]] = {}
    for file in sorted(Path(folder).rglob("*")):
        if file.is_file() and "__pycache__" not in file.parts:
            files.setdefault(f"share/{NAME}/{file.parent.as_posix()}", []).append(file.as_posix())
    return list(files.items())


setup(
    name=NAME,
    version="0.2.0",
    packages=[],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *installed("launch"),
        *installed("control"),
        *installed("foxglove"),
        *installed("rviz"),
        *installed("security"),
        *installed("configs"),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},  # by which colcon knows what runs the tests
    zip_safe=False,
    maintainer="the softsim authors",
    maintainer_email="softsim@users.noreply.example.org",
    description="Launch files, files for RViz, Foxglove, ros2_control, SROS 2; robots' and scenes' files.",
    license="Apache-2.0",
)
