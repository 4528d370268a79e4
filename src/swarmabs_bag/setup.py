from setuptools import find_packages, setup

PACKAGE = "swarmabs_bag"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Recorder of swarmabs; writing, reading, repairing and splitting its MCAP bags",
    maintainer="swarmabs maintainers",
    maintainer_email="maintainers@swarmabs.example",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={PACKAGE: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools", "PyYAML", "mcap", "numpy", "zstandard"],
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "recorder = swarmabs_bag.recorder.node:main",
            "recorder_realtime = swarmabs_bag.recorder.realtime:main",
        ],
    },
)
