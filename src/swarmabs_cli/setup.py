from setuptools import find_packages, setup

PACKAGE = "swarmabs_cli"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="The command line of swarmabs",
    maintainer="swarmabs maintainers",
    maintainer_email="maintainers@swarmabs.example",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={PACKAGE: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools", "click", "psutil", "rich"],
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "swarm = swarmabs_cli:main",
        ],
    },
)
