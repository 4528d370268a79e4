from setuptools import find_packages, setup

PACKAGE = "swarmabs_config"

setup(
    name=PACKAGE,
    version="0.1.0",
    description="Scenario, fleet file and graph of swarmabs: everything that is declared",
    maintainer="swarmabs maintainers",
    maintainer_email="maintainers@swarmabs.example",
    license="Apache-2.0",
    packages=find_packages(),
    package_data={PACKAGE: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=["setuptools", "PyYAML", "numpy", "pydantic>=2"],
    zip_safe=False,
)
