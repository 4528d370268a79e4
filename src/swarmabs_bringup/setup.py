from glob import glob

from setuptools import find_packages, setup

PACKAGE = "swarmabs_bringup"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Scenarios, launch files, orchestration, recorder and command line of swarmabs.",
    maintainer="swarmabs maintainers",
    maintainer_email="maintainers@swarmabs.example",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={PACKAGE: ["py.typed", "view/static/*", "view/third_party/uplot/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/launch", sorted(glob("launch/*.*"))),
        (f"share/{PACKAGE}/scenarios", sorted(glob("scenarios/*.yaml"))),
        (f"share/{PACKAGE}/urdf", sorted(glob("urdf/*.urdf"))),
        (f"share/{PACKAGE}/rviz", sorted(glob("rviz/*.rviz"))),
        (f"share/{PACKAGE}/foxglove", sorted(glob("foxglove/*.json"))),
    ],
    install_requires=[
        "setuptools",
        "PyYAML",
        "click",
        "matplotlib",
        "mcap",
        "numpy",
        "psutil",
        "rich",
        "zstandard",
    ],
    extras_require={
        "deploy": ["cryptography>=41"],
        "foxglove": ["foxglove-sdk"],
        "parquet": ["pyarrow"],
        "sweep": ["dask", "distributed", "pyarrow"],
        "view": ["aiohttp"],
    },
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "swarm = swarmabs_bringup.cli:main",
            "recorder = swarmabs_bringup.recorder.node:main",
            "recorder_realtime = swarmabs_bringup.recorder.realtime:main",
            "plane_markers = swarmabs_bringup.visualization.node:main",
        ],
    },
)
